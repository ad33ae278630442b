"""Where downloads and results that are kept are."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def cache_dir() -> Path:
    """Folder of downloads and retargeted clips: ``QUESTSIM_CACHE`` or the platform's cache."""
    return Path(os.environ.get("QUESTSIM_CACHE") or platformdirs.user_cache_dir("questsim"))
