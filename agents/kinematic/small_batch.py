"""Products of weights with a few rows: what a streamed frame consists of.

A frame reads every weight once, for one row or a few. PyTorch's products are made for many rows
and take longer than the weights' way from memory; these loops hardly do. They are for networks that
only answer: with gradients, and for many rows, PyTorch's own products give the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from questsim.compiled import jit

MOST_ROWS = 8
_APART = 16
"""Numbers between rows: a power of two apart, they would drive each other out of the cache."""

# Sums in any order, as matrix products have them; numbers that are not finite stay what they are.
_jit: Any = jit(fastmath={"reassoc", "contract", "nsz"})
_pytorch_alone = False


@contextmanager
def pytorch_alone() -> Iterator[None]:
    """Only PyTorch's products, whose operations its counter sees."""
    global _pytorch_alone
    before, _pytorch_alone = _pytorch_alone, True
    try:
        yield
    finally:
        _pytorch_alone = before


def is_small_batch(x: Tensor, rows: int) -> bool:
    """Whether so many rows of ``x`` are multiplied by the loops here."""
    return (
        rows <= MOST_ROWS
        and not torch.is_grad_enabled()
        and not _pytorch_alone
        and x.dtype is torch.float32
        and x.device.type == "cpu"
        and not torch.is_autocast_enabled("cpu")
    )


def linear(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """``torch.nn.functional.linear``.

    Args:
        x: ``(..., K)``.
        weight: ``(N, K)``.
        bias: ``(N,)``.

    Returns:
        ``(..., N)``.
    """
    width = x.shape[-1]
    rows = x.numel() // width
    if not is_small_batch(x, rows):
        return torch.nn.functional.linear(x, weight, bias)
    out = np.empty((1, rows, len(weight)), np.float32)
    flat = x.detach().contiguous().view(1, rows, width).numpy()
    _products(flat, weight.detach().numpy()[None], bias.detach().numpy()[None], out)
    return torch.from_numpy(out).view(*x.shape[:-1], len(weight))


def group_linear(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Linear layers side by side.

    Args:
        x: ``(groups, rows, K)``.
        weight: ``(groups, N, K)``.
        bias: ``(groups, N)``.

    Returns:
        ``(groups, rows, N)``.
    """
    if not is_small_batch(x, x.shape[1]):
        return torch.baddbmm(bias[:, None], x, weight.transpose(1, 2))
    out = np.empty((*x.shape[:2], weight.shape[1]), np.float32)
    _products(x.detach().contiguous().numpy(), weight.detach().numpy(), bias.detach().numpy(), out)
    return torch.from_numpy(out)


def side_by_side(
    layers: Sequence[nn.Linear], columns: Sequence[Sequence[int]]
) -> tuple[Tensor, Tensor, Tensor]:
    """Linear layers of any widths as ``group_linear`` takes them, filled up with zeros.

    Args:
        layers: all of them.
        columns: which numbers of a common input each reads.

    Returns:
        columns ``(groups, K)``, weights ``(groups, N, K)`` and bias ``(groups, N)``.
    """
    count = max(layer.out_features for layer in layers)
    width = max(layer.in_features for layer in layers)
    index = torch.zeros(len(layers), width, dtype=torch.long)
    weight = torch.zeros(len(layers), count, width)
    bias = torch.zeros(len(layers), count)
    for g, (layer, read) in enumerate(zip(layers, columns, strict=True)):
        index[g, : len(read)] = torch.as_tensor(read)
        weight[g, : layer.out_features, : layer.in_features] = layer.weight.detach()
        bias[g, : layer.out_features] = layer.bias.detach()
    return index, weight, bias


class Linear(nn.Linear):
    """``torch.nn.Linear`` through ``linear``."""

    def forward(self, input: Tensor) -> Tensor:
        """``(..., in)`` to ``(..., out)``."""
        return linear(input, self.weight, self.bias)


class EncoderLayer(nn.TransformerEncoderLayer):
    """PyTorch's layer (batch first, norms last, ReLU), with the products here where it answers."""

    def forward(self, src: Tensor, *args: Any, **options: Any) -> Tensor:
        """As PyTorch's ``(B, T, size)``; no mask where there are few rows."""
        if self.training or not is_small_batch(src, src.numel() // src.shape[-1]):
            return super().forward(src, *args, **options)
        attention = self.self_attn
        told = linear(src, attention.in_proj_weight, attention.in_proj_bias)
        query, key, value = told.unflatten(-1, (3, attention.num_heads, -1)).permute(2, 0, 3, 1, 4)
        mixed = nn.functional.scaled_dot_product_attention(query, key, value)
        out = attention.out_proj
        x = self.norm1(src + linear(mixed.transpose(1, 2).flatten(2), out.weight, out.bias))
        inner = torch.relu(linear(x, self.linear1.weight, self.linear1.bias))
        return self.norm2(x + self.linear2(inner))


@_jit
def _products(x, weight, bias, out):
    """``out[g] = x[g] weight[g]^T + bias[g]``, of at most ``MOST_ROWS`` rows."""
    groups, rows, width = x.shape
    padded = np.zeros((MOST_ROWS, width + _APART), np.float32)
    for g in range(groups):
        if rows == 1:
            _one(x[g, 0], weight[g], bias[g], out[g, 0])
        else:
            padded[:rows, :width] = x[g]
            _eight(padded, weight[g], bias[g], out[g])


@_jit
def _one(x, weight, bias, out):
    for n in range(weight.shape[0]):
        total = np.float32(0.0)
        for k in range(weight.shape[1]):
            total += x[k] * weight[n, k]
        out[n] = bias[n] + total


@_jit
def _eight(x, weight, bias, out):
    """Of eight rows, as many as ``out`` has are kept: a weight is read once for all of them."""
    told = np.empty(MOST_ROWS, np.float32)
    for n in range(weight.shape[0]):
        a = b = c = d = e = f = g = h = np.float32(0.0)
        for k in range(weight.shape[1]):
            w = weight[n, k]
            a += x[0, k] * w
            b += x[1, k] * w
            c += x[2, k] * w
            d += x[3, k] * w
            e += x[4, k] * w
            f += x[5, k] * w
            g += x[6, k] * w
            h += x[7, k] * w
        told[0], told[1], told[2], told[3] = a, b, c, d
        told[4], told[5], told[6], told[7] = e, f, g, h
        for m in range(len(out)):
            out[m, n] = bias[n] + told[m]
