"""Several LSTMs of the same size side by side, with weight normalisation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from agents.kinematic.derived_weights import DerivedWeights
from agents.kinematic.small_batch import group_linear

LstmState = tuple[Tensor, Tensor]
"""Hidden and cell state, each ``(groups, B, size)``."""


class LstmBank(DerivedWeights):
    """One LSTM per group; each reads and writes only its own group's features.

    Both weight matrices are normalised by row (Salimans and Kingma 2016) into a length and a
    direction per row, as in HMD-Poser's released code.

    Args:
        groups: number of groups.
        size: input and output features per group.
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

    def _weights(self) -> tuple[Tensor, Tensor]:
        """Both matrices side by side ``(groups, 4 size, 2 size)``, and the bias."""

        def weight(direction: Tensor, length: Tensor) -> Tensor:
            unit = direction / direction.norm(dim=-1, keepdim=True)
            return unit * length[..., None]

        into = weight(self.input_direction, self.input_length)
        across = weight(self.hidden_direction, self.hidden_length)
        return torch.cat([into, across], dim=-1), self.input_bias + self.hidden_bias

    def forward(self, x: Tensor, state: LstmState | None = None) -> tuple[Tensor, LstmState]:
        """Run over time.

        Args:
            x: ``(B, T, groups, size)``.
            state: initial state; None for zeros.

        Returns:
            hidden states ``(B, T, groups, size)`` and the state after the last frame.
        """
        if state is None:
            zero = x.new_zeros(self.groups, len(x), self.size)
            state = (zero, zero)
        return self._step(x, state) if x.shape[1] == 1 else self._sequence(x, state)

    def _step(self, x: Tensor, state: LstmState) -> tuple[Tensor, LstmState]:
        """One frame of all groups at once."""
        weights, bias = self.derived(self._weights)
        seen = torch.cat([x[:, 0].transpose(0, 1), state[0]], dim=-1)
        i, f, g, o = group_linear(seen, weights, bias).chunk(4, dim=-1)
        cell = torch.sigmoid(f) * state[1] + torch.sigmoid(i) * torch.tanh(g)
        hidden = torch.sigmoid(o) * torch.tanh(cell)
        return hidden.transpose(0, 1)[:, None], (hidden, cell)

    def _sequence(self, x: Tensor, state: LstmState) -> tuple[Tensor, LstmState]:
        """Run group by group through PyTorch's LSTM, which is fast on sequences."""
        kind = torch.get_autocast_dtype("cpu") if torch.is_autocast_enabled("cpu") else x.dtype
        both, bias = (w.to(kind) for w in self.derived(self._weights))
        into, across = both.split(self.size, dim=-1)
        none, outputs, hidden, cell = torch.zeros_like(bias[0]), [], [], []
        for group in range(self.groups):
            weights = [
                into[group].contiguous(),
                across[group].contiguous(),
                bias[group],
                none,
            ]
            before = (state[0][group, None].to(kind), state[1][group, None].to(kind))
            out, h, c = torch.lstm(
                x[:, :, group].to(kind).contiguous(),
                before, weights, True, 1, 0.0, self.training, False, True,
            )  # fmt: skip
            outputs.append(out)
            hidden.append(h[0])
            cell.append(c[0])
        after = (torch.stack(hidden).to(x.dtype), torch.stack(cell).to(x.dtype))
        return torch.stack(outputs, dim=2).to(x.dtype), after
