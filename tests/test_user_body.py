"""The body of a user whose stature alone is known, and estimated bodies that keep to it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from agents.kinematic import UserBody
from agents.kinematic.recurrent.hmdposer import HmdPoserSpec
from agents.kinematic.recurrent.lgsik import LgsikSpec
from agents.kinematic.recurrent.poser import RecurrentModule, RecurrentPoser, RecurrentSpec
from agents.kinematic.user_body import STATURE_TOLERANCE
from questsim.errors import InputError
from questsim.joint_sensors import readings
from questsim.motion.checks import stature_of
from questsim.motion.retarget_back import to_motion
from questsim.sensors import sensor_set
from tests.helpers import swaying_clip

MOTION = to_motion(swaying_clip(frames=20)).resampled(60.0)
SMALL = HmdPoserSpec(size=32, blocks=1, layers=1, heads=1, feed_forward=8, head_hidden=8)


@pytest.mark.parametrize("height", [1.2, 1.6, 1.75, 2.2])
def test_a_body_of_a_stature_has_it(height: float) -> None:
    body = UserBody.of_height(height)
    assert body.height_m == height
    assert stature_of(body.offsets) == pytest.approx(height, rel=0.01)


@pytest.mark.parametrize("height", [1.1, 2.3, float("nan")])
def test_a_stature_of_no_adult_is_refused(height: float) -> None:
    with pytest.raises(InputError, match=r"is not within 1\.2 to 2\.2 m"):
        UserBody.of_height(height)


@pytest.mark.parametrize("spec", [SMALL, LgsikSpec(size=16, hidden=(8, 8), shape_hidden=8)])
def test_an_estimated_body_keeps_to_a_stature_that_is_known(spec: RecurrentSpec) -> None:
    torch.manual_seed(0)
    module = RecurrentModule(spec)
    module.template.copy_(torch.as_tensor(MOTION.offsets))
    poser, seen = RecurrentPoser(module, "poser"), readings(MOTION, sensor_set("H+2C"))
    free = poser.predict(seen, UserBody.of(MOTION)).offsets
    estimated = stature_of(free[-1])
    for height in (0.8 * estimated, 1.2 * estimated):
        poses = poser.predict(seen, UserBody.of_height(height))
        found = np.array([stature_of(one) for one in poses.offsets])
        off = found / height - 1.0
        np.testing.assert_allclose(np.abs(off), STATURE_TOLERANCE, rtol=1e-4)
        # The whole body is scaled, and the head stays where it was measured.
        ratio = poses.offsets[-1] / np.where(free[-1] == 0.0, 1.0, free[-1])
        spread = ratio[free[-1] != 0.0]
        np.testing.assert_allclose(spread, spread[0], rtol=0.02)
    near = poser.predict(seen, UserBody(MOTION.offsets, estimated)).offsets
    np.testing.assert_array_equal(near, free)
