"""Torch work on two cores that gives the same bits on one."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from torch import Tensor


class Workers:
    """Runs independent torch jobs in parallel, each single-threaded.

    PyTorch's own threads split sums by thread count, so results would depend on it, and they are
    slow on small products. Jobs with a fixed split do not have these problems.

    Args:
        threads: with more than one, jobs run in parallel; the results are the same.
    """

    def __init__(self, threads: int = 1) -> None:
        self._pool = (
            ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,))
            if threads > 1
            else None
        )

    def run(self, *jobs: Callable[[], Any]) -> list[Any]:
        """The results of all jobs, in order; raises the first error."""
        if self._pool is None:
            return [job() for job in jobs]
        futures = [self._pool.submit(job) for job in jobs]
        return [future.result() for future in futures]

    def by_halves(self, function: Callable[[Tensor], Tensor], rows: Tensor) -> Tensor:
        """``function`` on the first and on the second half of ``rows``, without gradients."""

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
