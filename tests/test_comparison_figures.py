"""Figures of the comparison: their labels, and what their commands refuse."""

import numpy as np
import pytest

from agents.comparison.drawn import free_corners
from agents.comparison.plots import scenario_text
from agents.comparison.record import FILE, Record
from agents.comparison.report import Row
from docs.figures.comparison_pictures import kept_options
from docs.figures.comparison_windows import by_frame, systems_of
from questsim.errors import InputError
from questsim.motion.retarget_back import to_motion
from tests.helpers import swaying_clip


def test_a_number_stands_where_neither_another_dot_nor_its_number_is():
    assert free_corners(np.array([[0.2, 0.2], [0.8, 0.8]])) == [(1, 1), (1, 1)]
    # The second dot is where the first one's number would stand.
    first, second = free_corners(np.array([[0.50, 0.50], [0.53, 0.53]]))
    assert first == (-1, -1) and second != (-1, -1)
    # Numbers of three dots in one place go to three sides.
    assert len(set(free_corners(np.full((3, 2), 0.5)))) == 3
    assert free_corners(np.zeros((0, 2))) == []


@pytest.mark.parametrize(
    ("scenario", "text"),
    [
        ("6", "6 trackers"),
        ("4, no predictor", "4 trackers, no predictor"),
        ("5 no left foot", "5 no left foot"),
        ("60 Hz", "60 Hz"),
        ("HMD+2IMU", "HMD+2IMU"),
    ],
)
def test_figures_say_what_a_number_of_devices_counts(scenario, text):
    assert scenario_text(Row("a", scenario, 0, {}, {}, None)) == text


def test_errors_by_frame_are_only_of_systems_and_motions_with_windows():
    with pytest.raises(InputError, match="ik does not have the protocol with windows"):
        systems_of(["ik"])
    ((system, plain),) = systems_of(["lgsik"]).values()
    assert [scenario.name for scenario in plain] == ["HMD", "HMD+2IMU", "HMD+3IMU"]
    with pytest.raises(InputError, match="no motion has 40 frames"):
        by_frame(system, plain[0], [to_motion(swaying_clip(frames=10)).resampled(60.0)])


def test_figures_are_drawn_again_with_the_options_of_their_comparison(tmp_path):
    data = {"motions": "some:test", "clips": 7}
    what = {"data": data, "seed": 3, "fewer_clips": 2, "fewer_rows": ["noise"]}
    with Record(tmp_path, what, {}):
        pass
    assert kept_options(tmp_path) == {
        "motions": "some:test", "max_clips": 7, "seed": 3, "fewer_clips": 2,
        "fewer_rows": ("noise",),
    }  # fmt: skip
    (tmp_path / FILE).write_text("")
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match="has no comparison"):
            kept_options(folder)
