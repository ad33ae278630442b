"""A person in an emulated headset drives the avatar through the page, end to end."""

import json
from pathlib import Path

import browser
import numpy as np
import pytest
from emulated_headset import (
    PRESS_BOTH,
    glb_links,
    polled,
    rows_of,
    running,
    wear,
    why_no_page,
)

from agents.follower.follower import Follower
from agents.follower.replay import calibrated, replayed
from questsim.devices import DeviceFrame, from_ours
from questsim.exporting import write_clip
from questsim.motion.clip import FPS
from questsim.motion.spec import load_motions
from questsim.recordings import DeviceRecording, read_recording
from questsim.skeleton import LINKS

NO_PAGE = why_no_page(browser.missing())
pytestmark = pytest.mark.skipif(bool(NO_PAGE), reason=NO_PAGE or "never")


@pytest.fixture(scope="module")
def chromium():
    """One browser for all tests; it takes seconds to start."""
    with browser.new_browser(160, 120) as context:
        yield context


@pytest.fixture(scope="module")
def walk() -> DeviceRecording:
    """The first five seconds of the shipped recording, every third frame: drawing is slow here."""
    whole = read_recording(Path("synthetic"))
    end = whole.frames[0].time_s + 5.0
    return DeviceRecording(tuple(f for f in whole.frames if f.time_s < end)[::3])


def test_person_in_an_emulated_headset_moves_the_avatar_as_the_recording_does(
    chromium, walk, tmp_path
):
    rows, out, texts = rows_of(walk.frames), tmp_path / "came.jsonl.gz", []
    with running("--agent", "hmdposer", "--record", str(out)) as address:
        tab = chromium.new_page()
        tab.on("websocket", lambda ws: ws.on("framereceived", lambda text: texts.append(text)))
        wear(tab, address, rows)
        polled(tab, f"window.lastPose?.seen >= {rows[-1]['t'] - 1e-3}")
        assert "device error" in tab.inner_text("#numbers")
        # Without this feature a headset keeps bare hands to itself.
        assert "hand-tracking" in tab.evaluate("features")
        # A wearer cannot press the page's button.
        tab.evaluate(PRESS_BOTH)
        polled(tab, "document.getElementById('text').textContent.startsWith('stand')")
        tab.close()
    came = read_recording(out)
    # Every row arrived, in order, as it was recorded.
    assert [f.time_s for f in came.frames] == pytest.approx([r["t"] for r in rows], abs=2e-5)
    for row, frame in zip(rows, came.frames, strict=True):
        assert set(frame.poses) == set(row) - {"t"}
        for name, found in frame.poses.items():
            expected = DeviceFrame.of(0.0, {name: row[name]}, "openxr").poses[name]
            assert found.position == pytest.approx(expected.position, abs=1e-4)
            assert abs(found.quat @ expected.quat) == pytest.approx(1.0, abs=1e-6)
    # And in every frame the avatar was where the same recording puts it without a page.
    follower = Follower("hmdposer")
    rest = calibrated(follower, came)
    poses = {
        round(frame.time_s, 4): from_ours(pose.link_position, pose.link_quat, "openxr")[0]
        for frame, pose in zip(rest, replayed(follower, rest), strict=True)
    }
    shown = [m for m in map(json.loads, texts) if m["type"] == "pose"]
    shown = [m for m in shown if m["dropped"] == 0]  # a busy machine drops frames
    assert len(shown) > 10
    for message in shown:
        assert np.reshape(message["p"], (16, 3)) == pytest.approx(poses[message["seen"]], abs=0.001)


def test_exported_animation_plays_in_three(chromium, tmp_path):
    clip = load_motions("synthetic:walk")[0]
    write_clip(tmp_path / "walk.glb", clip)
    at = np.array([0, len(clip) // 2, len(clip) - 2])
    found = glb_links(chromium, (tmp_path / "walk.glb").read_bytes(), LINKS, at / FPS)
    # x of glTF is our left, y our up, z our forward.
    assert found[..., [2, 0, 1]] == pytest.approx(clip.link_position[at], abs=1e-4)
