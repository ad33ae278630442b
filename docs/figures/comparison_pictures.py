"""Pictures, tables and film of a comparison: ``python -m docs.figures.comparison_pictures SCORES``.

    python -m docs.figures.comparison_pictures SCORES [--film]

Draws the figures of a folder's complete rows again, without computing any, and puts them into
``docs/images``. Those that need means alone (accuracy, plausibility) are drawn from the kept report
beside the shipped weights, which has the rows of every agent; its tables are put into the pages, as
by ``comparison_table --write``. ``--film`` also makes the film, its sheet and the worst clips with
the shipped agents; the film stays in SCORES.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import tyro
from tyro.conf import Positional

from agents.comparison.compare import FIGURES, compare
from agents.comparison.conditions import Start
from agents.comparison.drawn import DRAWN, PREDICTOR, first_starts
from agents.comparison.film import SHEET
from agents.comparison.options import CompareArgs
from agents.comparison.record import FILE as RECORD_FILE
from agents.comparison.worst import FILE as WORST
from agents.kinematic.device_faults import Noise
from agents.shipping.cards import SOURCE
from docs.figures.comparison_table import rows_of, write_pages
from questsim.cli import guarded
from questsim.errors import InputError
from questsim.files import whole_file

IMAGES = Path(__file__).parents[1] / "images"
FILMED = (
    "dataset-2_walk_masculine_005",
    "dataset-2_run_feminine_035",
    "dataset-2_raise-up-both-hands_feminine_035",
)
"""Clips of the film: a walk, a run and a gesture."""


@dataclass(frozen=True)
class PicturesArgs:
    """Draw the figures of a comparison into docs/images, and write its tables into the pages."""

    scores: Positional[Path]
    """Folder of the comparison (evaluate.py --compare --out)."""
    film: bool = False
    """Also make the film, the sheet and the worst clips."""
    agents: tuple[str, ...] = ()
    """Only these agents, in figures and film."""


def kept_options(scores: Path) -> dict[str, Any]:
    """Motions, numbers of clips and seed of the comparison in a folder, as in ``CompareArgs``.

    Raises:
        InputError: there is no comparison in the folder.
    """
    try:
        with (scores / RECORD_FILE).open(encoding="utf-8") as file:
            what = json.loads(file.readline())
        found = {
            "motions": what["data"]["motions"],
            "max_clips": what["data"]["clips"],
            "fewer_clips": what["fewer_clips"],
            "seed": what["seed"],
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            "has no comparison", scores, "name the --out of evaluate.py --compare"
        ) from error
    return found | {key: tuple(what[key]) for key in ("fewer_rows",) if key in what}


def draw(args: PicturesArgs) -> int:
    """Draw the figures, copy them, write the tables; returns the exit code.

    Raises:
        InputError: see ``kept_options`` and ``compare``.
    """
    code = compare(
        CompareArgs(
            agents=args.agents,
            **kept_options(args.scores),
            out=args.scores,
            starts=get_args(Start),
            noise=get_args(Noise),
            windows=True,
            finished=True,
            times=False,
            threads=1,
            video=args.film,
            video_clips=FILMED if args.film else (),
        )
    )
    kept = rows_of(SOURCE)
    for name, plot in FIGURES.items():
        with whole_file(IMAGES / f"comparison-{name}") as path:
            plot(first_starts(kept), path)
    write_pages(kept)
    made = [*DRAWN, PREDICTOR, *((SHEET, WORST) if args.film else ())]
    for name in made:
        if (args.scores / name).is_file():
            picture = "sheet.png" if name == SHEET else name.replace("_", "-")
            shutil.copyfile(args.scores / name, IMAGES / f"comparison-{picture}")
    return code


if __name__ == "__main__":
    raise SystemExit(guarded(lambda: draw(tyro.cli(PicturesArgs))))
