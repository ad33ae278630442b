"""Weights derived from parameters; in inference they are derived only once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import torch
from torch import nn

_T = TypeVar("_T")


class DerivedWeights(nn.Module):
    """A module that caches weights derived from its parameters while these cannot change."""

    def __init__(self) -> None:
        super().__init__()
        self._kept: object = None

    def train(self, mode: bool = True) -> DerivedWeights:
        """Switch to training or evaluation; clears the cache."""
        self._kept = None
        return super().train(mode)

    def derived(self, make: Callable[[], _T]) -> _T:
        """The result of ``make``, cached in evaluation without gradients."""
        if self.training or torch.is_grad_enabled():
            return make()
        if self._kept is None:
            self._kept = make()
        return self._kept  # type: ignore[return-value]
