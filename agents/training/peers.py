"""Averages over the workers that share the updates of one policy or kinematic system."""

from __future__ import annotations

import io
from collections.abc import Iterable
from datetime import timedelta
from typing import Any, Protocol

import torch
import torch.distributed
from torch import Tensor, nn

distributed: Any = torch.distributed
"""Its type stubs leave out the stores."""

TIMEOUT = timedelta(minutes=10)
"""Longest wait for another worker; one that died is noticed at once."""

Address = tuple[str, int]
"""Where workers meet: a new file and 0 on one machine, else host and port of the first worker."""


class PeerLostError(RuntimeError):
    """Another worker of the same update died or cannot be reached."""


class Peers(Protocol):
    """The workers that share an update; all of them must make the same calls in the same order."""

    def mean(self, values: Tensor) -> Tensor:
        """Mean of each worker's ``values``."""
        ...

    def mean_and_std(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the values of all workers together."""
        ...

    def each(self, values: Tensor) -> list[Tensor]:
        """The ``values`` of every worker, in the workers' order."""
        ...

    def average_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Replace the gradients by their means over the workers."""
        ...


class Alone:
    """``Peers`` of a learner that computes its updates alone."""

    def mean(self, values: Tensor) -> Tensor:
        """The values themselves."""
        return values

    def mean_and_std(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the values."""
        return values.mean(), values.std()

    def each(self, values: Tensor) -> list[Tensor]:
        """The values themselves."""
        return [values]

    def average_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Does nothing: there are no other gradients."""


ALONE = Alone()


class GlooPeers:
    """``Peers`` in other processes, connected by PyTorch's gloo.

    The order of the sums depends on the number of workers alone, so results have the same bits in
    every run and in every worker.

    Args:
        group: a process group of PyTorch.
        count: number of workers.
    """

    def __init__(self, group: Any, count: int) -> None:
        self._group, self._count = group, count

    def mean(self, values: Tensor) -> Tensor:
        """Mean of each worker's ``values``."""
        total = values.detach().clone().contiguous()
        self._wait(lambda: self._group.allreduce([total]))
        return total / self._count

    def mean_and_std(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the values of all workers together, by Chan et al."""
        own = values.detach().double()
        about = torch.stack(
            [torch.tensor(float(own.numel())).double(), own.mean(), own.var(0, False)]
        )
        count, mean, var = torch.stack(self.each(about)).unbind(1)
        total = count.sum()
        overall = (count * mean).sum() / total
        squares = (count * (var + (mean - overall).square())).sum()
        return overall.to(values.dtype), (squares / (total - 1)).sqrt().to(values.dtype)

    def each(self, values: Tensor) -> list[Tensor]:
        """The ``values`` of every worker, in the workers' order."""
        own = values.detach().contiguous()
        found = [torch.empty_like(own) for _ in range(self._count)]
        self._wait(lambda: self._group.allgather([found], [own]))
        return found

    def average_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Replace the gradients by their means over the workers, in one message."""
        gradients = [p.grad for p in parameters if p.grad is not None]
        mean = self.mean(torch.cat([gradient.flatten() for gradient in gradients]))
        parts = mean.split([gradient.numel() for gradient in gradients])
        for gradient, part in zip(gradients, parts, strict=True):
            gradient.copy_(part.view_as(gradient))

    @staticmethod
    def _wait(call: Any) -> None:
        try:
            call().wait()
        except RuntimeError as error:
            raise PeerLostError(str(error)) from error


def packed(state: dict[str, Any]) -> bytes:
    """A state of networks and optimisers, to be sent to other workers."""
    file = io.BytesIO()
    torch.save(state, file)
    return file.getvalue()


def unpacked(state: bytes) -> dict[str, Any]:
    """The inverse of ``packed``."""
    return torch.load(io.BytesIO(state), weights_only=True)


class Meeting:
    """How workers find each other.

    Args:
        file: a file in a folder of this user that does not exist yet, for workers on one machine;
            None opens a port, for workers on several.
        host: address of this worker.
    """

    def __init__(self, file: str | None, host: str) -> None:
        self._store: Any = None
        self.address: Address = (file or "", 0)
        if file is None:
            self._store = distributed.TCPStore(
                host, 0, is_master=True, wait_for_workers=False, timeout=TIMEOUT
            )
            self.address = (host, self._store.port)


def join(
    address: Address, host: str, rank: int, count: int, groups: int, meeting: Meeting | None = None
) -> list[GlooPeers]:
    """Connect to the other workers.

    Args:
        address: where the workers meet.
        host: address of this worker; it listens on no other.
        rank: number of this worker.
        count: number of workers.
        groups: number of independent groups, for calls from several threads.
        meeting: of the first worker, which opened it.

    Returns:
        The groups.

    Raises:
        PeerLostError: a worker does not come.
    """
    gloo: Any = distributed.ProcessGroupGloo
    where, port = address
    try:
        store: Any = None if meeting is None else meeting._store
        if store is None and port:
            store = distributed.TCPStore(where, port, is_master=False, timeout=TIMEOUT)
        elif store is None:
            store = distributed.FileStore(where, count)
        found = []
        for number in range(groups):
            # PyTorch's public options would listen on the address of the machine's name.
            options = gloo._Options()
            options._devices, options._timeout = [gloo.create_device(hostname=host)], TIMEOUT
            prefixed = distributed.PrefixStore(str(number), store)
            found.append(GlooPeers(gloo(prefixed, rank, count, options), count))
    except RuntimeError as error:
        raise PeerLostError(str(error)) from error
    return found
