"""Settings for all tests; they must stand before NumPy, PyTorch and Matplotlib are imported."""

import os
import tempfile

# Two test processes with many OpenMP threads each slow one another tenfold.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
# Tests neither fill nor rely on the user's cache of downloads and retargeted clips.
os.environ.setdefault("QUESTSIM_CACHE", tempfile.mkdtemp(prefix="questsim-test-cache-"))

from hypothesis import settings

# A busy machine is not a failure, and the same commit always tries the same examples.
settings.register_profile("questsim", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("questsim")
