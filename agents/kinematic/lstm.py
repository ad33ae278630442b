"""Several LSTMs of one size side by side, with weight normalisation, run by batched products."""

from __future__ import annotations

import torch
from torch import Tensor, nn

State = tuple[Tensor, Tensor]
"""Hidden and cell state, each ``(groups, B, size)``."""


class LstmBank(nn.Module):
    """One LSTM a group; each reads and writes only its own group's features.

    Both weight matrices are normalised by row (Salimans and Kingma 2016), as HMD-Poser's released
    code has them: a length and a direction for every row.

    Args:
        groups: how many.
        size: features in and out.
    """

    def __init__(self, groups: int, size: int) -> None:
        super().__init__()
        self.groups, self.size = groups, size
        self.input_direction = nn.Parameter(torch.empty(groups, 4 * size, size))
        self.hidden_direction = nn.Parameter(torch.empty(groups, 4 * size, size))
        for weight in (self.input_direction, self.hidden_direction):
            for group in weight.data:
                nn.init.orthogonal_(group)
        self.input_length = nn.Parameter(self.input_direction.detach().norm(dim=-1))
        self.hidden_length = nn.Parameter(self.hidden_direction.detach().norm(dim=-1))
        bound = size**-0.5
        self.input_bias = nn.Parameter(torch.empty(groups, 4 * size).uniform_(-bound, bound))
        self.hidden_bias = nn.Parameter(torch.empty(groups, 4 * size).uniform_(-bound, bound))
        self._ready: tuple[Tensor, Tensor, Tensor] | None = None

    def train(self, mode: bool = True) -> LstmBank:
        """Switch to training or evaluation; forgets the weights kept for evaluation."""
        self._ready = None
        return super().train(mode)

    def _weights(self) -> tuple[Tensor, Tensor, Tensor]:
        """Both matrices transposed ``(groups, size, 4 size)`` and the bias."""
        if self._ready is not None:
            return self._ready

        def weight(direction: Tensor, length: Tensor) -> Tensor:
            unit = direction / direction.norm(dim=-1, keepdim=True)
            return (unit * length[..., None]).transpose(1, 2).contiguous()

        ready = (
            weight(self.input_direction, self.input_length),
            weight(self.hidden_direction, self.hidden_length),
            (self.input_bias + self.hidden_bias)[:, None],
        )
        if not self.training and not torch.is_grad_enabled():
            self._ready = ready
        return ready

    def forward(self, x: Tensor, state: State | None = None) -> tuple[Tensor, State]:
        """Run over time.

        Args:
            x: ``(B, T, groups, size)``.
            state: to go on from; None for zeros.

        Returns:
            hidden states ``(B, T, groups, size)`` and the state after the last frame.
        """
        batch, frames = x.shape[:2]
        into, across, bias = self._weights()
        flat = x.permute(2, 1, 0, 3).reshape(self.groups, frames * batch, self.size)
        gates = torch.baddbmm(bias, flat, into).view(self.groups, frames, batch, 4 * self.size)
        if state is None:
            zero = x.new_zeros(self.groups, batch, self.size)
            state = (zero, zero)
        hidden, cell = state
        outputs = []
        for t in range(frames):
            i, f, g, o = torch.baddbmm(gates[:, t], hidden, across).chunk(4, dim=-1)
            cell = torch.sigmoid(f) * cell + torch.sigmoid(i) * torch.tanh(g)
            hidden = torch.sigmoid(o) * torch.tanh(cell)
            outputs.append(hidden)
        return torch.stack(outputs, dim=0).permute(2, 0, 1, 3), (hidden, cell)
