"""Estimates of many motions at once: on several processes of this machine, or on Ray workers."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

import torch

from agents.evaluation.mapping import Mapper
from agents.training.ray_session import ray_map
from questsim.extensions import load_extensions


@contextmanager
def process_map(count: int, on_ray: int = 0, ray: str | None = None) -> Iterator[Mapper]:
    """A ``map`` on several processes with one thread each; results have the same bits.

    Threads would not help: Python code takes most of a frame's time.

    Args:
        count: processes of this machine.
        on_ray: Ray workers that are used instead, if any.
        ray: address of their cluster.

    Raises:
        InputError: see ``ray_map``.
    """
    torch.set_num_threads(1)
    if on_ray or ray is not None:
        with ray_map(on_ray, ray) as mapper:
            yield mapper
        return
    if count == 1:
        yield map
        return
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin_process) as pool:
        yield pool.map


def _begin_process() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the command's process handles Ctrl-C
    load_extensions()
    torch.set_num_threads(1)
