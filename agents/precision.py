"""Choose bfloat16 or float32: bfloat16 is fast only on processors that support it natively."""

from __future__ import annotations

from functools import lru_cache

import torch

_NATIVE = ("avx512_bf16", "amx_bf16", "bf16")
"""Keys of native bfloat16 in ``torch.cpu.get_capabilities``, on x86 and Arm."""


@lru_cache(maxsize=1)
def native_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 natively.

    Native matrix products take half of float32's time. Without native support PyTorch emulates
    them, which took 40 times as long.
    """
    capabilities = torch.cpu.get_capabilities()
    return any(capabilities.get(name, False) for name in _NATIVE)


def products(coarse: bool) -> torch.autocast:
    """Context for matrix products: bfloat16 if ``wanted`` and native, otherwise float32."""
    return torch.autocast("cpu", torch.bfloat16, coarse and native_bfloat16())
