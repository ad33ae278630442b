"""Settings for all tests; they must stand before NumPy, PyTorch and Matplotlib are imported."""

import os
import tempfile
from pathlib import Path

# Two test processes with many OpenMP threads each slow one another tenfold.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
# Tests neither fill nor rely on the user's cache of downloads and retargeted clips.
os.environ.setdefault("QUESTSIM_CACHE", tempfile.mkdtemp(prefix="questsim-test-cache-"))

import pytest
from hypothesis import settings

# A busy machine is not a failure, and the same commit always tries the same examples.
settings.register_profile("questsim", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("questsim")

LONGEST = [
    "cluster", "docs", "comparison", "kinematic_training", "workers", "export", "ablations", "page",
    "training", "evaluate", "packaging", "headset_page", "fuzz", "worlds", "specialists",
    "scorecard", "with_libraries",
]  # fmt: skip
"""Files that take longest, so that no process is left with one of them at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files; the two with most Ray processes are not side by side."""

    def place(item: pytest.Item) -> int:
        name = Path(item.path).stem.removeprefix("test_")
        return LONGEST.index(name) if name in LONGEST else len(LONGEST)

    items.sort(key=place)
