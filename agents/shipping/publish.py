"""``questsim publish``: upload an agent's weights with card and licence to the Hugging Face Hub."""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

from agents.hub import FILES, hub, plain_errors, split_name
from agents.licence import UNKNOWN, licence_of
from agents.resolve import Resolved, resolve
from agents.shipping.options import PublishArgs
from agents.shipping.ship import MODEL_CARD, ShipArgs, ship_folder
from questsim.errors import InputError

HUB_LICENCES = {"MIT": "mit", "CC-BY-NC-4.0": "cc-by-nc-4.0"}
"""Licence names of the Hub; it takes any other licence as ``other`` with a name."""


def publish(args: PublishArgs) -> int:
    """Upload weights, description and card in one commit; returns the exit code.

    Raises:
        InputError: there are no weights, their licence is unknown, or the Hub refuses them.
    """
    repo, revision = split_name(args.to)
    if revision is not None:
        raise InputError("cannot be published to a revision", args.to, "leave out the @")
    library = hub(args.to)
    found = resolve(args.name)
    if found.folder is None or found.kind not in ("policy", "system"):
        raise InputError("has no weights to publish", args.name, "name a run or shipped agent")
    with tempfile.TemporaryDirectory() as place:
        folder, licence = _packed(args, found, repo, Path(place))
        _add_header(folder / MODEL_CARD, library, licence, found.kind)
        api = library.HfApi()
        with plain_errors(args.to):
            api.create_repo(repo, private=args.private, exist_ok=True)
            done = api.upload_folder(
                repo_id=repo,
                folder_path=folder,
                allow_patterns=list(FILES),
                delete_patterns=list(FILES),
                commit_message=f"{folder.name}, by questsim publish",
            )
    print(f"published {args.to}, {licence}: {done.commit_url}")
    return 0


def _packed(args: PublishArgs, found: Resolved, repo: str, place: Path) -> tuple[Path, str]:
    """A folder to upload, and its licence: a shipped agent's as it is, a run's with a new card."""
    assert found.folder is not None
    if (found.folder / MODEL_CARD).is_file():
        if args.metrics:
            fix = "leave it out"
            raise InputError(f"does nothing: {args.name} has a card", "--metrics", fix)
        licence = licence_of(found.training)
        if licence == UNKNOWN:
            raise InputError("some of its training motions have no stated licence", args.name)
        folder = place / found.folder.name
        shutil.copytree(found.folder, folder)
        return folder, licence
    name = re.sub(r"[^a-z0-9]+", "-", repo.rpartition("/")[2].lower()).strip("-")
    _, licence = ship_folder(
        ShipArgs(run=found.folder, name=name, metrics=args.metrics, into=place)
    )
    return place / name, licence


def _add_header(card: Path, library: Any, licence: str, kind: str) -> None:
    """Put the Hub's metadata before the card."""
    known = HUB_LICENCES.get(licence)
    other = {} if known else {"license_name": licence.lower().replace(" ", "-")}
    data = library.ModelCardData(
        license=known or "other",
        library_name="questsim",
        tags=["motion-tracking", "virtual-reality", "mujoco", kind],
        **other,
    )
    text = card.read_text(encoding="utf-8")
    card.write_text(f"---\n{data.to_yaml()}\n---\n\n{text}", encoding="utf-8")
