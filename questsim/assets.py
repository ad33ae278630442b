"""Location of the MJCF files: ``assets/mjcf`` of a checkout, ``questsim/_mjcf`` of a wheel."""

from __future__ import annotations

from pathlib import Path

from questsim.errors import InputError

_PACKAGE = Path(__file__).parent
_FOLDERS = (_PACKAGE / "_mjcf", _PACKAGE.parent / "assets" / "mjcf")


def mjcf_path(name: str) -> Path:
    """The path of a shipped MJCF file.

    An installed wheel has the files beside this module (``pyproject.toml`` maps them there). A
    checkout, also with ``pip install -e``, has them in its top-level folder ``assets``.

    Args:
        name: name of the file, e.g. ``"humanoid.xml"``.

    Raises:
        InputError: the file does not exist.
    """
    for folder in _FOLDERS:
        if (folder / name).is_file():
            return folder / name
    raise InputError(f"no MJCF file {name!r} is shipped", fix="install the package again")
