"""Torch work on two cores that gives the same bits on one."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from torch import Tensor


class Workers:
    """Runs independent pieces of torch work side by side, each single-threaded.

    PyTorch's own threads split sums and products by their number, and small ones badly: a training
    would depend on the threads it was given. Pieces that are cut beforehand do not.

    Args:
        threads: above one, pieces run side by side; the results are the same.
    """

    def __init__(self, threads: int = 1) -> None:
        self._pool = (
            ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,))
            if threads > 1
            else None
        )

    def run(self, *jobs: Callable[[], Any]) -> list[Any]:
        """The results of all jobs, in their order; the first error is raised."""
        if self._pool is None:
            return [job() for job in jobs]
        futures = [self._pool.submit(job) for job in jobs]
        return [future.result() for future in futures]

    def by_halves(self, function: Callable[[Tensor], Tensor], rows: Tensor) -> Tensor:
        """``function`` of the first and of the second half of ``rows``, without gradients."""

        def of(part: Tensor) -> Tensor:
            with torch.no_grad():
                return function(part)

        middle = (len(rows) + 1) // 2
        parts = [part for part in (rows[:middle], rows[middle:]) if len(part)]
        return torch.cat(self.run(*(lambda part=part: of(part) for part in parts)))

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()
