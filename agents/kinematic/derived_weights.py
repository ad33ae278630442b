"""Weights that are derived from parameters, and derived only once while a network just answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import torch
from torch import nn

_T = TypeVar("_T")


class DerivedWeights(nn.Module):
    """A module that keeps what it derives from its parameters while they cannot change."""

    def __init__(self) -> None:
        super().__init__()
        self._kept: object = None

    def train(self, mode: bool = True) -> DerivedWeights:
        """Switch to training or evaluation; forgets what is kept for evaluation."""
        self._kept = None
        return super().train(mode)

    def derived(self, make: Callable[[], _T]) -> _T:
        """What ``make`` gives, kept while evaluating without gradients."""
        if self.training or torch.is_grad_enabled():
            return make()
        if self._kept is None:
            self._kept = make()
        return self._kept  # type: ignore[return-value]
