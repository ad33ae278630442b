"""Whether coarser numbers pay here: bfloat16 is fast only where the processor computes with it."""

from __future__ import annotations

from functools import lru_cache

import torch

_NATIVE = ("avx512_bf16", "amx_bf16", "bf16")
"""Names in ``torch.cpu.get_capabilities``, of x86 and of Arm."""


@lru_cache(maxsize=1)
def native_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 by itself.

    Where it does, matrix products take half of float32's time; where it does not, PyTorch
    imitates them, which took 40 times as long.
    """
    capabilities = torch.cpu.get_capabilities()
    return any(capabilities.get(name, False) for name in _NATIVE)


def products(coarse: bool) -> torch.autocast:
    """Matrix products in what follows: in bfloat16, if wanted and native, or in float32."""
    return torch.autocast("cpu", torch.bfloat16, coarse and native_bfloat16())
