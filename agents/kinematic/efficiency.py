"""Cost of streaming a kinematic system: multiply-accumulates per frame, and memory."""

from __future__ import annotations

from collections import deque
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from agents.kinematic.interface import KinematicSystem, UserBody
from agents.kinematic.small_batch import pytorch_alone
from questsim.joint_sensors import SensorSequence

WARM_UP_FRAMES = 8
COUNTED_FRAMES = 4


def mmac_a_frame(system: KinematicSystem, sequence: SensorSequence, body: UserBody) -> float:
    """Millions of multiply-accumulates of matrix products and convolutions per streamed frame.

    ``torch.utils.flop_counter`` counts them (two operations per multiply-accumulate) over a few
    frames in the middle of a stream. It counts the executed products, including masked-out weights.
    If a stream has its own compiled products, the equivalent PyTorch products are counted. Sums,
    activations and products outside PyTorch are not counted; attention between eight tokens is
    counted where it is a matrix product.

    Args:
        system: the system to measure; its stream is restarted.
        sequence: signals of devices that it can use, without dropouts.
        body: the user's body.
    """
    fused = torch.backends.mha.get_fastpath_enabled()
    # The fused transformer layer of inference hides its products from the counter.
    torch.backends.mha.set_fastpath_enabled(False)
    try:
        frames = min(len(sequence), WARM_UP_FRAMES + COUNTED_FRAMES)
        warm = max(frames - COUNTED_FRAMES, 0)
        system.reset(body, sequence.names)
        for t in range(warm):
            system.step(sequence[t])
        with pytorch_alone(), FlopCounterMode(display=False) as counter:
            for t in range(warm, frames):
                system.step(sequence[t])
    finally:
        torch.backends.mha.set_fastpath_enabled(fused)
    return counter.get_total_flops() / 2e6 / (frames - warm)


def stream_kib(system: KinematicSystem) -> float:
    """KiB of the tensors and arrays that a system keeps between frames.

    This is all state of the stream, including the user's bones. Networks, which streams share, and
    plain Python objects are not counted. Views of one storage count once, with the whole storage.

    Args:
        system: in the middle of a stream.
    """
    found: dict[int, int] = {}
    # Networks and options have public names; state set by ``reset`` is private.
    _add([value for name, value in vars(system).items() if name.startswith("_")], found)
    return sum(found.values()) / 1024.0


def _add(value: Any, found: dict[int, int]) -> None:
    """Record address and size in bytes of every tensor and array in nested containers."""
    if isinstance(value, torch.Tensor):
        storage = value.untyped_storage()
        found[storage.data_ptr()] = storage.nbytes()
    elif isinstance(value, np.ndarray):
        found[value.__array_interface__["data"][0]] = value.nbytes
    elif isinstance(value, dict):
        _add(list(value.values()), found)
    elif isinstance(value, list | tuple | deque):
        for each in value:
            _add(each, found)
    elif is_dataclass(value):
        _add([getattr(value, field.name) for field in fields(value)], found)
