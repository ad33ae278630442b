"""A headset emulated by iwer in headless Chromium, and ``questsim live`` as a process."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.headset.server import PAGE
from questsim.devices import DeviceFrame, from_ours

ROOT = Path(__file__).parents[1]
IWER = ROOT / "web" / "node_modules" / "iwer" / "build" / "iwer.min.js"

# An emulated headset that shows one recorded row a frame, at the row's own time.
EMULATOR = """
const device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
device.stereoEnabled = false;
if (BARE) device.primaryInputMode = "hand";
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
    const grip = row[`${side}_controller`], hand = (BARE ? device.hands : device.controllers)[side];
    hand.connected = Boolean(grip);
    if (!grip) continue;
    const quat = times(grip.slice(3), back(offsets[side].quat));
    const shift = turned(quat, offsets[side].position);
    hand.position.set(...grip.slice(0, 3).map((x, i) => x - shift[i]));
    hand.quaternion.set(...quat);
  }
}
// Meanwhile the last row is shown again and again.
let still = false;
window.pressBoth = async (name, ms) => {
  still = true;
  const hands = Object.values(device.controllers);
  for (const hand of hands) hand.updateButtonValue(name, 1);
  await new Promise((done) => setTimeout(done, ms));
  for (const hand of hands) hand.updateButtonValue(name, 0);
};
const request = navigator.xr.requestSession.bind(navigator.xr);
navigator.xr.requestSession = async (...words) => {
  window.features = words[1].optionalFeatures;
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
    if (still || current >= 0 && current < rows.length) {
      const { t } = rows[Math.min(current, rows.length - 1)];
      Object.defineProperty(frame, "predictedDisplayTime", { value: 1000 * t });
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

PRESS_BOTH = "pressBoth('trigger', 2500)"
"""Press the triggers of both controllers for as long as a new measurement wants."""

# A glTF file in three.js, its animation at some times: the places of named nodes in the world.
PLAYER = """
<script type="importmap">{"imports": {
  "three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import { AnimationMixer, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
const file = await new GLTFLoader().loadAsync("/motion.glb");
const mixer = new AnimationMixer(file.scene);
mixer.clipAction(file.animations[0]).play();
window.placesAt = (names, times) => times.map((time) => {
  mixer.setTime(time);
  file.scene.updateMatrixWorld(true);
  return names.map((name) =>
    file.scene.getObjectByName(name).getWorldPosition(new Vector3()).toArray());
});
</script>
"""


def why_no_page(no_browser: str) -> str:
    """Why the page cannot be tried here; empty if it can.

    Args:
        no_browser: why there is no browser, see ``browser.missing``.
    """
    if no_browser:
        return no_browser
    if not (PAGE / "live.js").is_file():
        return "the page is not built: run make page"
    if not IWER.is_file():
        return "iwer, the emulated headset, is not installed: run make page"
    return ""


def rows_of(frames: Sequence[DeviceFrame]) -> list[dict[str, Any]]:
    """Frames as WebXR would show them; those without a headset are left out."""
    rows = []
    for frame in frames:
        if "headset" not in frame.poses:
            continue
        row: dict[str, Any] = {"t": frame.time_s}
        for name, pose in frame.poses.items():
            row[name] = np.concatenate(from_ours(pose.position, pose.quat, "openxr")).tolist()
        rows.append(row)
    return rows


@contextlib.contextmanager
def running(*words: str) -> Iterator[str]:
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


def polled(tab: Any, script: str, seconds: float = 60.0) -> Any:
    """The first value of a script that is true; the page allows no scripts made of text."""
    end = time.monotonic() + seconds
    while not (value := tab.evaluate(script)):
        assert time.monotonic() < end, script
        time.sleep(0.1)
    return value


def wear(tab: Any, address: str, rows: Sequence[dict[str, Any]], bare: bool = False) -> None:
    """Open the page in the emulated headset, enter VR, and show it all rows, one a frame.

    Args:
        tab: of the browser.
        address: of the page.
        rows: see ``rows_of``.
        bare: whether the user has bare hands, at the places of the rows' controllers.
    """
    tab.add_init_script(IWER.read_text())
    tab.add_init_script(
        EMULATOR.replace("ROWS", json.dumps(rows)).replace("BARE", json.dumps(bare))
    )
    tab.goto(address)
    polled(tab, "document.getElementById('VRButton') && true")
    tab.evaluate("document.getElementById('VRButton').click()")
    polled(tab, "document.getElementById('text').textContent.startsWith('stand')")
    tab.evaluate("startRows()")
    polled(tab, "rowsDone()", 600.0)


def glb_links(
    context: Any, glb: bytes, names: Sequence[str], times_s: Sequence[float] | np.ndarray
) -> np.ndarray:
    """Play a GLB file in three.js: places ``(T, N, 3)`` of nodes in the axes of the file.

    Args:
        context: a browser, see ``browser.new_browser``.
        glb: the file.
        names: of the N nodes.
        times_s: T times in seconds.
    """
    three = IWER.parents[2] / "three"

    def answer(route: Any) -> None:
        path = route.request.url.removeprefix("http://three.invalid")
        if path.startswith("/three/"):
            route.fulfill(path=three / path.removeprefix("/three/"))
        elif path == "/motion.glb":
            route.fulfill(body=glb, content_type="model/gltf-binary")
        else:
            route.fulfill(body=PLAYER, content_type="text/html")

    tab = context.new_page()
    tab.route("http://three.invalid/**", answer)
    tab.goto("http://three.invalid/")
    polled(tab, "window.placesAt && true")
    found = tab.evaluate("([names, times]) => placesAt(names, times)", [list(names), list(times_s)])
    tab.close()
    return np.array(found)
