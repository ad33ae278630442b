"""Agents on the Hugging Face Hub: names ``hf:USER/REPO`` or ``hf:USER/REPO@REVISION``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from questsim.errors import InputError

PREFIX = "hf:"
FILES = ("policy.yaml", "system.yaml", "*.safetensors", "README.md")
"""Files that are downloaded: descriptions and weights, none of which can run code."""


def split_name(name: str) -> tuple[str, str | None]:
    """Repository and revision of a name.

    Raises:
        InputError: it is no such name.
    """
    repo, at, revision = name.removeprefix(PREFIX).partition("@")
    part = r"[A-Za-z0-9][\w.-]*"
    if not name.startswith(PREFIX) or not re.fullmatch(f"{part}/{part}", repo):
        raise InputError("is not hf:USER/REPO or hf:USER/REPO@REVISION", name)
    if at and not revision:
        raise InputError("has no revision after the @", name)
    return repo, revision or None


@lru_cache(maxsize=32)
def downloaded(name: str) -> Path:
    """The folder of an agent, downloaded once and kept in the Hub's own cache.

    Without a network, the folder in the cache is used.

    Raises:
        InputError: no such repository, or it cannot be reached and is not in the cache.
    """
    repo, revision = split_name(name)
    library = hub(name)
    with plain_errors(name):
        place = library.snapshot_download(repo, revision=revision, allow_patterns=list(FILES))
    return Path(place)


def hub(where: str) -> Any:
    """The module ``huggingface_hub``.

    Raises:
        InputError: it is not installed.
    """
    try:
        import huggingface_hub
    except ModuleNotFoundError:
        fix = "pip install 'questsim[hub]'"
        raise InputError("needs huggingface-hub, which is not installed", where, fix) from None
    return huggingface_hub


@contextmanager
def plain_errors(name: str) -> Iterator[None]:
    """Turn errors of the Hub's client into one line.

    Raises:
        InputError: instead of them.
    """
    from huggingface_hub import errors

    # The client changed its HTTP library; its own errors are of that library's base class.
    ancestors = errors.HfHubHTTPError.__mro__
    unreachable: Any = next(each for each in ancestors if each.__name__ in ("HTTPError", "OSError"))
    try:
        yield
    except errors.RevisionNotFoundError:
        raise InputError("there is no such revision on the Hub", name) from None
    except errors.GatedRepoError:
        fix = "accept its terms on the Hub, then run hf auth login"
        raise InputError("needs its owner's permission", name, fix) from None
    except errors.RepositoryNotFoundError:
        fix = "check the name; for a private one run hf auth login"
        raise InputError("there is no such repository on the Hub", name, fix) from None
    except errors.LocalTokenNotFoundError:
        raise InputError("no account of the Hub is logged in", name, "run hf auth login") from None
    except errors.LocalEntryNotFoundError:
        what = "the Hub does not answer, and it is not in the cache"
        raise InputError(what, name, "check the network") from None
    except errors.HfHubHTTPError as error:
        status = error.response.status_code
        fix = "run hf auth login with a token that may write" if status in (401, 403) else None
        raise InputError(f"the Hub answered {status}", name, fix) from None
    except (unreachable, ConnectionError) as error:
        raise InputError(f"the Hub does not answer ({error})", name, "check the network") from None
