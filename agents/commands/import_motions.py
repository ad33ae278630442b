"""``questsim motions import``: read motion files here or on the workers of Ray."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from agents.training.watched import beside_ray
from questsim.motion.many import PartMapper, Refused, Retargeted
from questsim.motion.motions_command import import_motions
from questsim.motion_options import ImportArgs

Results = list[Retargeted | Refused]


@beside_ray
def import_on_workers(args: ImportArgs) -> None:
    """Write a library of the files' motions and clips; workers make the same ones.

    Raises:
        InputError: see ``import_motions``; or Ray or its cluster cannot be used.
    """
    import_motions(args, _workers(args) if args.workers or args.ray is not None else None)


def _workers(args: ImportArgs) -> PartMapper:
    """A map on Ray workers, which start when it is called: after the options are checked."""
    # Imported here: this loads PyTorch, which an import on this machine alone does not need.
    from agents.training.ray_session import check_workers, ray_map

    check_workers(args.workers, args.ray)

    def mapped(function: object, parts: Sequence[Sequence[Path]]) -> Iterator[Results]:
        with ray_map(args.workers, args.ray) as mapper:
            yield from mapper(function, parts)  # type: ignore[arg-type]

    return mapped
