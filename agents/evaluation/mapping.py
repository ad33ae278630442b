"""The interface of functions like ``map`` that may run their calls elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar

JobT = TypeVar("JobT")
ResultT = TypeVar("ResultT")


class Mapper(Protocol):
    """Like ``map``: the results of a function on every job, in order."""

    def __call__(
        self, function: Callable[[JobT], ResultT], jobs: Iterable[JobT], /
    ) -> Iterable[ResultT]:
        """The results."""
        ...
