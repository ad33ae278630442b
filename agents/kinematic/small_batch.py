"""Products of weight matrices with few rows, as in streaming.

A streamed frame reads every weight once, for one or a few rows. PyTorch's products are optimised
for many rows and take longer than reading the weights from memory; these loops take about as long
as reading. They are used only in inference with few rows. With gradients or many rows, PyTorch's
products give the same result.
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
"""Padding between rows: rows at a power-of-two distance would evict each other from the cache."""

# Sums may be reordered, as in matrix products; non-finite values are preserved.
_jit: Any = jit(fastmath={"reassoc", "contract", "nsz"})
_pytorch_alone = False


@contextmanager
def pytorch_alone() -> Iterator[None]:
    """Use only PyTorch's products, which PyTorch's operation counter can count."""
    global _pytorch_alone
    before, _pytorch_alone = _pytorch_alone, True
    try:
        yield
    finally:
        _pytorch_alone = before


def is_small_batch(x: Tensor, rows: int) -> bool:
    """Whether the loops of this module are used for ``rows`` rows of ``x``."""
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
    """Several linear layers at once.

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
    """Pad linear layers of different widths with zeros for ``group_linear``.

    Args:
        layers: the layers.
        columns: for each layer, the columns of the common input that it reads.

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
    """PyTorch's layer (batch first, norms last, ReLU) with this module's products in inference."""

    def forward(self, src: Tensor, *args: Any, **options: Any) -> Tensor:
        """Like PyTorch's, ``(B, T, size)``; masks are not supported with few rows."""
        if self.training or not is_small_batch(src, src.numel() // src.shape[-1]):
            return super().forward(src, *args, **options)
        attention = self.self_attn
        projected = linear(src, attention.in_proj_weight, attention.in_proj_bias)
        query, key, value = projected.unflatten(-1, (3, attention.num_heads, -1)).permute(
            2, 0, 3, 1, 4
        )
        mixed = nn.functional.scaled_dot_product_attention(query, key, value)
        out = attention.out_proj
        x = self.norm1(src + linear(mixed.transpose(1, 2).flatten(2), out.weight, out.bias))
        inner = torch.relu(linear(x, self.linear1.weight, self.linear1.bias))
        return self.norm2(x + self.linear2(inner))


@_jit
def _products(x, weight, bias, out):
    """``out[g] = x[g] weight[g]^T + bias[g]`` for at most ``MOST_ROWS`` rows."""
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
    """Compute eight rows, reading each weight once, and store as many as ``out`` has."""
    sums = np.empty(MOST_ROWS, np.float32)
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
        sums[0], sums[1], sums[2], sums[3] = a, b, c, d
        sums[4], sums[5], sums[6], sums[7] = e, f, g, h
        for m in range(len(out)):
            out[m, n] = bias[n] + sums[m]
