"""A Ray cluster: joined or started on this machine, watched, and used like ``map``."""

from __future__ import annotations

import os
import socket
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import chdir, contextmanager, nullcontext
from typing import Any

import torch

from agents.evaluation.mapping import JobT, Mapper, ResultT
from agents.run_folder import versions
from agents.training.peers import PeerLostError
from questsim.errors import InputError
from questsim.extensions import load_extensions

RETRIES = 3
"""Attempts after the first one of a job whose process or node died."""
QUIET: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
"""Options of ``ray.init``."""
STARTS = 3
"""Attempts to start Ray on this machine."""
PATIENCE = {
    "RAY_agent_register_timeout_ms": "300000",
    "RAY_worker_register_timeout_seconds": "300",
}
"""Ray's limits for the start of its processes. By default a node ends when its agent takes longer
than 30 s to start, as it does beside other programs on few cores."""
CHECK_S = 5.0
"""While waiting for results, the head is asked this often whether it still answers."""
CHECKS = 5
"""Attempts to reach the head before it counts as dead."""


class HeadLostError(InputError):
    """The head of the cluster died: nothing more can be asked of any worker."""


@contextmanager
def ray_cluster(address: str | None, cores: int) -> Iterator[None]:
    """Context of a Ray cluster: a new one on this machine, or an existing one.

    Args:
        address: of an existing cluster; None starts one on this machine, on loopback only.
        cores: cores that the workers need on this machine.

    Raises:
        InputError: Ray is not installed, or no cluster answers at the address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address is None:
        # Only this setting binds a Ray node to loopback, so that no other node can join it.
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        # Ray's default, 15, starves the workers beside other programs while the learner waits.
        os.environ.setdefault("RAY_worker_niceness", "0")
        for name, value in PATIENCE.items():
            os.environ.setdefault(name, value)
    else:
        os.environ.setdefault("RAY_AUTH_MODE", "token")
        # By default Ray tries 20 times, which takes a quarter of an hour.
        os.environ.setdefault("RAY_NUM_REDIS_GET_RETRIES", "2")
    try:
        import ray
    except ModuleNotFoundError:
        fix = "pip install 'questsim[cluster]'"
        raise InputError("needs Ray, which is not installed", "--workers", fix) from None
    began = not ray.is_initialized()
    if began:
        if address is None:
            _start(ray, cores)
        else:
            _connect(ray, address)
    try:
        yield
    finally:
        if began and head_answers():
            ray.shutdown()


def _connect(ray: Any, address: str) -> None:
    where, fix = f"--ray {address}", "start it by: ray start --head (docs/scaling.md)"
    host, _, port = address.rpartition(":")
    if not host or "/" in host or not port.isdecimal():
        raise InputError("is not an address HOST:PORT", where, "as in HEAD:6379")
    try:  # Ray itself would try for minutes
        socket.create_connection((host.strip("[]"), int(port)), timeout=CHECK_S).close()
    except (OSError, OverflowError, UnicodeError) as error:
        raise InputError(f"no Ray cluster answers there: {error}", where, fix) from None
    try:
        with _silent():
            ray.init(address=address, **QUIET)
    except Exception as error:  # Ray raises plain ones, too
        what = f"no Ray cluster answers there: {_reason(error)}"
        raise InputError(what, where, fix) from None
    on_head = ray.remote(num_cpus=0, resources={"node:__internal_head__": 0.001})(_authentication)
    if result(on_head.remote()) != "token":
        ray.shutdown()
        fix = "set RAY_AUTH_MODE=token on every node and start the cluster again (docs/scaling.md)"
        raise InputError("whoever reaches this cluster can run code there", where, fix)


def _authentication() -> str:
    return os.environ.get("RAY_AUTH_MODE", "token")


@contextmanager
def _silent() -> Iterator[None]:
    """Context without Ray's own lines on stderr about an error that it then raises."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _start(ray: Any, cores: int) -> None:
    for attempt in range(1, STARTS + 1):
        try:
            # "local": without it Ray would join a cluster that happens to run here.
            ray.init("local", num_cpus=cores, include_dashboard=False, **QUIET)
            return
        except Exception as error:  # a plain one, if the start takes Ray longer than 30 s
            if attempt == STARTS:
                fix = "try again when the machine is less busy, or see Ray's logs"
                raise InputError(
                    f"Ray did not start: {_reason(error)}", "--workers", fix
                ) from error


def _reason(error: Exception) -> str:
    return (" ".join(str(error).split()) or type(error).__name__)[:400]


# -- waiting for results -----------------------------------------------------------------------


def result(reference: Any) -> Any:
    """The result of a call, like ``ray.get``, which waits for ever when the head has died.

    Raises:
        HeadLostError: the head does not answer any more.
        InputError: the call itself raised it.
    """
    import ray
    from ray import exceptions as errors

    while True:
        try:
            return ray.get(reference, timeout=CHECK_S)
        except errors.GetTimeoutError:
            check_head()
        except errors.RayTaskError as error:
            if isinstance(error.cause, InputError):
                raise error.cause from None
            raise


def first_error(references: list[Any]) -> list[Any]:
    """Results of calls that wait for one another.

    Raises:
        PeerLostError: one of them lost its process or another one.
        HeadLostError: the head does not answer any more.
        InputError: a call itself raised it.
    """
    import ray
    from ray import exceptions as errors

    waiting = references
    while waiting:
        done, waiting = ray.wait(waiting, timeout=CHECK_S)
        if not done:
            check_head()
        for reference in done:
            try:
                result(reference)
            except (errors.RayActorError, errors.ObjectLostError, errors.OwnerDiedError) as error:
                raise PeerLostError(str(error)) from error
            except errors.RayTaskError as error:
                if isinstance(error.cause, PeerLostError):
                    raise PeerLostError(str(error.cause)) from error
                raise
    return [result(reference) for reference in references]


def check_head() -> None:
    """Do nothing as long as the head lives.

    Raises:
        HeadLostError: the head does not answer.
    """
    for _ in range(CHECKS):
        if head_answers():
            return
        time.sleep(1.0)
    fix = "start the cluster again, then continue by the same command and --resume"
    raise HeadLostError("the head of the Ray cluster died", "--workers", fix)


def head_answers() -> bool:
    """Whether the process that manages the cluster accepts connections."""
    import ray

    host, _, port = ray.get_runtime_context().gcs_address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=CHECK_S).close()
    except OSError:
        return False
    return True


def on_one_machine() -> bool:
    """Whether the cluster is of this machine alone and listens on loopback."""
    import ray

    return all(node["NodeManagerAddress"] == "127.0.0.1" for node in ray.nodes())


def own_host() -> str:
    """Address of the node that this process runs on."""
    import ray

    return ray.util.get_node_ip_address()


@contextmanager
def meeting_file() -> Iterator[str | None]:
    """The file of a ``Meeting`` of workers on this machine alone; None if there are others."""
    with tempfile.TemporaryDirectory(prefix="questsim-") as folder:
        yield os.path.join(folder, "peers") if on_one_machine() else None


# -- work that is independent clip by clip -----------------------------------------------------


def check_workers(workers: int, address: str | None) -> None:
    """Check the options ``--workers`` and ``--ray``.

    Raises:
        InputError: there are fewer than 0 workers, or a cluster without workers.
    """
    if workers < 0:
        raise InputError(f"is {workers}, below 0", "--workers")
    if workers == 0 and address is not None:
        raise InputError("needs --workers", "--ray", "add --workers N")


@contextmanager
def ray_map(workers: int, address: str | None = None, cores: int = 1) -> Iterator[Mapper]:
    """A function like ``map`` whose calls run on Ray workers; plain ``map`` without workers.

    Args:
        workers: calls that run at the same time; 0 for none but this process.
        address: of a Ray cluster; None for one of this machine alone.
        cores: cores of one call.

    Raises:
        InputError: Ray is not installed, no cluster answers, it has too few cores, a node has
            other versions, or a call itself raised it.
    """
    check_workers(workers, address)
    if workers == 0:
        yield map
        return
    with ray_cluster(address, workers * cores):
        check_room(workers, cores)
        yield _mapped(workers, cores)


def check_room(workers: int, threads: int, memory: int = 0) -> None:
    """Refuse more workers than the cluster has cores or memory for.

    Args:
        workers: number of workers.
        threads: cores of each.
        memory: bytes of each.

    Raises:
        InputError: saying how much there is.
    """
    import ray

    wanted, found = workers * threads, int(ray.cluster_resources().get("CPU", 0))
    if wanted > found:
        raise InputError(
            f"{workers} workers of {threads} threads need {wanted} cores, the cluster has {found}",
            "--workers",
            "take fewer workers or threads, or add nodes",
        )
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    free = [node.get("memory", 0.0) for node in nodes]
    # A worker is on one node: what is left over on several nodes does not add up.
    room = sum(
        min(int(node.get("CPU", 0)) // threads, int(bytes_ // max(memory, 1)))
        for node, bytes_ in zip(nodes, free, strict=True)
    )
    if room < workers:
        raise InputError(
            f"{workers} workers of about {memory / 1e9:.1f} GB each do not fit: there is room for "
            f"{room} in the {sum(free) / 1e9:.1f} GB of the cluster",
            "--workers",
            "take fewer workers or --envs, or add nodes",
        )


def _mapped(workers: int, cores: int) -> Mapper:
    import ray
    from ray import exceptions as errors

    own, here = versions(), os.getcwd()
    task = ray.remote(num_cpus=cores, max_retries=RETRIES)(_call)

    def of(reference: Any) -> Any:
        try:
            return result(reference)
        except (errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError):
            fix = "see Ray's logs; a worker may need more memory than its node has"
            raise InputError(f"died {RETRIES + 1} times", "a worker", fix) from None

    def mapped(function: Callable[[JobT], ResultT], jobs: Iterable[JobT]) -> Iterator[ResultT]:
        waiting: deque[Any] = deque()
        shared = ray.put(function)  # once for all jobs: it may hold their common data
        for job in jobs:
            if len(waiting) == workers:
                yield of(waiting.popleft())
            waiting.append(task.remote(shared, job, own, here, cores))
        while waiting:
            yield of(waiting.popleft())

    return mapped


def _call(
    function: Callable[[JobT], ResultT],
    job: JobT,
    wanted: dict[str, str],
    folder: str,
    threads: int,
) -> ResultT:
    with as_in_the_command(wanted, folder, threads):
        return function(job)


@contextmanager
def as_in_the_command(wanted: dict[str, str], folder: str, threads: int) -> Iterator[None]:
    """Context of work for a command on a node of its cluster.

    Args:
        wanted: versions of the command.
        folder: in which the command runs; on a node that has it, too, relative paths mean the same.
        threads: of PyTorch.

    Raises:
        InputError: the node has other versions.
    """
    load_extensions()
    check_versions(versions(), wanted, "a node of --ray")
    torch.set_num_threads(threads)
    with chdir(folder) if os.path.isdir(folder) else nullcontext():
        yield


def check_versions(found: dict[str, str], wanted: dict[str, str], where: str) -> None:
    """Refuse a node whose results would have other bits.

    Raises:
        InputError: naming the first library that differs.
    """
    for name, version in wanted.items():
        if found.get(name) != version:
            raise InputError(
                f"has {name} {found.get(name)}, the command has {version}",
                where,
                "install the same versions on every node",
            )
