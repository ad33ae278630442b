"""A person in an emulated headset drives the avatar through the page, end to end."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import browser
import numpy as np
import pytest

from agents.headset.server import PAGE
from questsim.devices import DeviceFrame, from_ours
from questsim.recordings import Recording, read_recording

ROOT = Path(__file__).parents[1]
IWER = ROOT / "web" / "node_modules" / "iwer" / "build" / "iwer.min.js"


@pytest.fixture(scope="module")
def walk() -> Recording:
    """The first seven seconds of the shipped recording."""
    whole = read_recording(Path("synthetic"))
    end = whole.frames[0].time_s + 7.0
    return Recording(tuple(f for f in whole.frames if f.time_s < end))


# An emulated headset that shows one recorded row a frame, at the row's own time.
EMULATOR = """
const device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
device.stereoEnabled = false;
const rows = ROWS;
let current = -1, started = false;
window.startRows = () => { started = true; };
window.rowsDone = () => current >= rows.length;
const times = (a, b) => [
  a[3]*b[0] + a[0]*b[3] + a[1]*b[2] - a[2]*b[1], a[3]*b[1] - a[0]*b[2] + a[1]*b[3] + a[2]*b[0],
  a[3]*b[2] + a[0]*b[1] - a[1]*b[0] + a[2]*b[3], a[3]*b[3] - a[0]*b[0] - a[1]*b[1] - a[2]*b[2]];
const back = (q) => [-q[0], -q[1], -q[2], q[3]];
const turned = (q, v) => times(times(q, [...v, 0]), back(q)).slice(0, 3);
const list = (v) => [v.x, v.y, v.z];
// The emulator is set by target rays, the recording has grips: a fixed offset lies between.
const offsets = {};
function place(row) {
  device.position.set(...row.headset.slice(0, 3));
  device.quaternion.set(...row.headset.slice(3));
  for (const side of ["left", "right"]) {
    const grip = row[`${side}_controller`], hand = device.controllers[side];
    hand.connected = Boolean(grip);
    if (!grip) continue;
    const quat = times(grip.slice(3), back(offsets[side].quat));
    const shift = turned(quat, offsets[side].position);
    hand.position.set(...grip.slice(0, 3).map((x, i) => x - shift[i]));
    hand.quaternion.set(...quat);
  }
}
const request = navigator.xr.requestSession.bind(navigator.xr);
navigator.xr.requestSession = async (...words) => {
  const session = await request(...words);
  const next = session.requestAnimationFrame.bind(session);
  session.requestAnimationFrame = (call) => next(function shown(time, frame) {
    if (Object.keys(offsets).length < 2) {
      for (const source of session.inputSources) {
        const pose = frame.getPose(source.gripSpace, source.targetRaySpace);
        if (pose) offsets[source.handedness] = {
          position: list(pose.transform.position),
          quat: [...list(pose.transform.orientation), pose.transform.orientation.w],
        };
      }
    }
    if (current >= 0 && current < rows.length) {
      Object.defineProperty(frame, "predictedDisplayTime", { value: 1000 * rows[current].t });
      call(time, frame);
    } else next(shown);
    // What is set now is seen in the next frame.
    if (started && current < rows.length && Object.keys(offsets).length === 2) {
      current += 1;
      if (current < rows.length) place(rows[current]);
    }
  });
  return session;
};
"""


def why_no_page() -> str:
    """Why the page cannot be tried here; empty if it can."""
    if browser.missing():
        return browser.missing()
    if not (PAGE / "live.js").is_file():
        return "the page is not built: run make page"
    if not IWER.is_file():
        return "iwer, the emulated headset, is not installed: run make page"
    return ""


def rows_of(recording: Recording) -> list[dict]:
    """A recording's frames as WebXR would show them; those without a headset are left out."""
    rows = []
    for frame in recording.frames:
        if "headset" not in frame.poses:
            continue
        row: dict = {"t": frame.time_s}
        for name, pose in frame.poses.items():
            row[name] = np.concatenate(from_ours(pose.position, pose.quat, "openxr")).tolist()
        rows.append(row)
    return rows


@contextlib.contextmanager
def running(*words: str):
    """``questsim live`` in a process of its own; gives its address."""
    command = [sys.executable, "-m", "questsim", "live", "--port", "0", *words]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment
    )
    try:
        assert process.stdout is not None
        found = re.search(r"http\S+", process.stdout.readline())
        assert found
        yield found[0]
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


def polled(tab, script: str, seconds: float = 60.0):
    """The first value of a script that is true; the page allows no scripts made of text."""
    end = time.monotonic() + seconds
    while not (value := tab.evaluate(script)):
        assert time.monotonic() < end, script
        time.sleep(0.1)
    return value


@pytest.mark.skipif(bool(why_no_page()), reason=why_no_page() or "never")
def test_person_in_an_emulated_headset_moves_the_avatar_as_the_recording_does(walk, tmp_path):
    from agents.follower.follower import Follower
    from agents.follower.replay import calibrated, replayed

    # Every second frame of five seconds: browsers that draw in software are slow.
    first = walk.frames[0].time_s
    frames = [frame for frame in walk.frames if frame.time_s < first + 5.0][::2]
    rows, out = rows_of(Recording(tuple(frames))), tmp_path / "came.jsonl.gz"
    words = ("--agent", "hmdposer", "--record", str(out))
    with running(*words) as address, browser.new_browser(160, 120) as context:
        tab = context.pages[0]
        tab.add_init_script(IWER.read_text())
        tab.add_init_script(EMULATOR.replace("ROWS", json.dumps(rows)))
        tab.goto(address)
        tab.evaluate("document.getElementById('VRButton').click()")
        polled(tab, "document.getElementById('text').textContent.startsWith('stand')")
        tab.evaluate("startRows()")
        polled(tab, "rowsDone()", 120.0)
        pose = polled(tab, f"window.lastPose?.seen >= {rows[-1]['t'] - 1e-3} && window.lastPose")
        assert "device error" in tab.inner_text("#numbers")
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
    follower = Follower("hmdposer", assist_n=100.0)
    rest = calibrated(follower, came)
    poses = replayed(follower, rest)
    last = poses[-1]
    place, _ = from_ours(last.link_position, last.link_quat, "openxr")
    assert np.array(pose["p"]).reshape(16, 3) == pytest.approx(place, abs=0.01)
