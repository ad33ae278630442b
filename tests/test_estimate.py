"""Motions that a kinematic system estimates, as a library."""

import numpy as np
import pytest

from questsim.cli import main
from questsim.motion.library import load_library, save_library
from questsim.motion.retarget_back import to_motion
from questsim.pose_metrics import HEAD
from tests.helpers import swaying_clip

MOTION = to_motion(swaying_clip(frames=24)).resampled(60.0)


def estimate(tmp_path, *options):
    motions = tmp_path / "motions.npz"
    save_library(motions, [MOTION], [])
    out = tmp_path / "estimated.npz"
    words = ["estimate", "--motions", str(motions), "--out", str(out), "--threads", "1", *options]
    return main(words), out


def test_an_estimate_is_a_library_of_motions_and_clips_named_after_the_system(tmp_path):
    code, out = estimate(tmp_path, "--agent", "hmdposer", "--sensors", "H+2C")
    assert code == 0
    library = load_library(out)
    (motion,), (clip,) = library.motions, library.clips
    assert motion.name == clip.name == f"{MOTION.name}@hmdposer"
    assert motion.kind == MOTION.kind and motion.licence == MOTION.licence
    want, got = MOTION.forward_kinematics()[0], motion.forward_kinematics()[0]
    assert np.abs(got[:, HEAD] - want[:, HEAD]).max() < 1e-3  # the headset says where it is
    assert 0.001 < np.linalg.norm(got - want, axis=-1).mean() < 0.2  # the rest is estimated


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--agent", "nobody"), "is not a kinematic system"),
        (("--agent", "hmdposer", "--sensors", "6T"), "hmdposer does not support 6T"),
        (("--agent", "hmdposer", "--sensors", "7T"), "unknown sensor set '7T'"),
        (("--agent", "questsim"), "is not a kinematic system"),
    ],
)
def test_agents_that_do_not_estimate_are_refused_in_one_line(options, message, tmp_path, capsys):
    code, out = estimate(tmp_path, *options)
    told = capsys.readouterr().err
    assert code == 2 and message in told and told.count("\n") == 1
    assert not out.exists()
