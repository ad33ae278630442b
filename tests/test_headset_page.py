"""A person in an emulated headset drives the avatar through the page, end to end."""

from pathlib import Path

import browser
import numpy as np
import pytest
from emulated_headset import polled, rows_of, running, wear, why_no_page

from questsim.devices import DeviceFrame, from_ours
from questsim.recordings import Recording, read_recording

NO_PAGE = why_no_page(browser.missing())


@pytest.fixture(scope="module")
def walk() -> Recording:
    """The first seven seconds of the shipped recording."""
    whole = read_recording(Path("synthetic"))
    end = whole.frames[0].time_s + 7.0
    return Recording(tuple(f for f in whole.frames if f.time_s < end))


@pytest.mark.skipif(bool(NO_PAGE), reason=NO_PAGE or "never")
def test_person_in_an_emulated_headset_moves_the_avatar_as_the_recording_does(walk, tmp_path):
    from agents.follower.follower import Follower
    from agents.follower.replay import calibrated, replayed

    # Every second frame of five seconds: browsers that draw in software are slow.
    first = walk.frames[0].time_s
    frames = [frame for frame in walk.frames if frame.time_s < first + 5.0][::2]
    rows, out = rows_of(frames), tmp_path / "came.jsonl.gz"
    words = ("--agent", "hmdposer", "--record", str(out))
    with running(*words) as address, browser.new_browser(160, 120) as context:
        tab = context.pages[0]
        wear(tab, address, rows)
        pose = polled(tab, f"window.lastPose?.seen >= {rows[-1]['t'] - 1e-3} && window.lastPose")
        assert "device error" in tab.inner_text("#numbers")
        # Without this feature a headset keeps bare hands to itself.
        assert "hand-tracking" in tab.evaluate("features")
    came = read_recording(out)
    # Every row arrived, in order, as it was recorded.
    assert [f.time_s for f in came.frames] == pytest.approx([r["t"] for r in rows], abs=2e-5)
    for row, frame in zip(rows, came.frames, strict=True):
        assert set(frame.poses) == set(row) - {"t"}
        for name, found in frame.poses.items():
            expected = DeviceFrame.of(0.0, {name: row[name]}, "openxr").poses[name]
            assert found.position == pytest.approx(expected.position, abs=1e-4)
            assert abs(found.quat @ expected.quat) == pytest.approx(1.0, abs=1e-6)
    # And the avatar is where the same recording puts it without a page.
    follower = Follower("hmdposer")
    rest = calibrated(follower, came)
    poses = replayed(follower, rest)
    last = poses[-1]
    place, _ = from_ours(last.link_position, last.link_quat, "openxr")
    assert np.array(pose["p"]).reshape(16, 3) == pytest.approx(place, abs=0.01)
