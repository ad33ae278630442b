"""What a name means, for every command alike."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers import swaying_clip

from agents import load_agent
from agents.comparison.compare import compare, shipped_agents
from agents.comparison.options import CompareArgs
from agents.evaluation import EvaluateArgs, evaluate
from agents.kinematic import load_system
from agents.live.drivers import TorqueDriver
from agents.live.load_driver import load_driver
from agents.live.poses import PoseDriver
from agents.resolve import PHYSICS, resolve, resolve_policy, resolve_system, system_folder
from questsim.errors import InputError
from questsim.motion.library import save_library
from questsim.motion.retarget_back import to_motion

AGENT = """
import numpy as np
from agents.agent import Needs


class Still:
    name, needs = "still", Needs(sensors="H")

    def bind(self, env): ...
    def reset(self, n): ...
    def act(self, obs):
        return np.zeros((len(obs), 33), np.float32)


class Greedy(Still):
    def __init__(self, size): ...


class Nothing:
    pass
"""
SYSTEM = """
from agents.kinematic.ik import InverseKinematics


class Mine(InverseKinematics):
    name = "mine"
"""


MOTION = to_motion(swaying_clip("sway", frames=40, height_m=1.7))


@pytest.fixture
def own(tmp_path, monkeypatch) -> Iterator[Path]:
    """A folder with modules of the user's own, where the command runs."""
    (tmp_path / "own_agent.py").write_text(AGENT)
    (tmp_path / "own_system.py").write_text(SYSTEM)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != ""])
    yield tmp_path
    for name in ("own_agent", "own_system"):
        sys.modules.pop(name, None)


@pytest.fixture
def library(tmp_path) -> str:
    clip = swaying_clip("sway", frames=40, height_m=1.7)
    save_library(tmp_path / "sway.npz", [to_motion(clip)], [clip])
    return str(tmp_path / "sway.npz")


def test_every_kind_of_name_is_distinguished():
    found = {name: resolve(name) for name in ("questsim", "zero", "ik", "hmdposer", "ik+physics")}
    assert [f.kind for f in found.values()] == ["policy", "baseline", "system", "system", "physics"]
    assert [f.torques for f in found.values()] == [True, True, False, False, False]
    assert found["ik+physics"].base == "ik" and found["ik"].folder is None
    assert found["hmdposer"].training["trained"] == ["network"]
    assert found["questsim"].card["format"] == "questsim-policy"


def test_an_unknown_agent_is_refused_with_the_list_of_agents():
    with pytest.raises(InputError) as refused:
        resolve("nobody")
    line = str(refused.value)
    assert "\n" not in line and line.startswith("nobody: is not an agent")
    for name in ("questsim", "estimate-tracker", "hmdposer", "ik", "zero", "random", PHYSICS):
        assert name in line
    for wrong in ("nobody+physics", "questsim+physics", "zero+physics"):
        with pytest.raises(InputError, match=r"is not a kinematic system; .*hmdposer.*ik"):
            resolve(wrong)
    with pytest.raises(InputError, match=r"hmdposer: is not a torque policy; .*questsim"):
        resolve_policy("hmdposer")
    with pytest.raises(InputError, match="questsim: is not a kinematic system"):
        resolve_system("questsim")
    with pytest.raises(InputError, match=r"gives no torques; .*ik\+physics"):
        load_agent("ik")


def test_of_a_run_the_stage_counts_that_was_trained_last(tmp_path):
    for stage, trained in (("vae", ["vae"]), ("predictor", ["vae", "predictor"])):
        for part in ("best", "last"):
            folder = tmp_path / stage / part
            folder.mkdir(parents=True)
            text = json.dumps({"agent": "dragposer", "training": {"trained": trained}})
            (folder / "system.yaml").write_text(text)
    assert system_folder(tmp_path) == tmp_path / "predictor" / "best"
    assert system_folder(tmp_path / "vae") == tmp_path / "vae" / "best"
    assert system_folder(tmp_path / "vae" / "last") == tmp_path / "vae" / "last"


def test_an_own_agent_is_evaluated_compared_and_shown(own, library, capsys):
    assert resolve("own_agent:Still").kind == "own"
    out = own / "scores"
    assert evaluate(EvaluateArgs("own_agent:Still", library, out=out, threads=1)) == 0
    written = json.loads((out / "metrics.json").read_text())
    assert written["context"]["agent"] == "own_agent:Still"
    assert written["context"]["config"]["sensors"] == "H"
    args = CompareArgs(agents=("own_agent:Still",), motions=library, out=own / "c", threads=1)
    assert compare(args) == 0
    rows = json.loads((own / "c" / "comparison.json").read_text())["rows"]
    assert [row["agent"] for row in rows] == ["recording", "own_agent:Still"]
    assert isinstance(load_driver("own_agent:Still", lambda name: MOTION), TorqueDriver)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("own_agent:Missing", "own_agent has no class Missing; it has Still, Greedy"),
        ("nowhere.module:Still", "there is no module nowhere"),
        ("own_agent:Nothing", "is neither an Agent nor a KinematicSystem"),
        ("own_agent:Greedy", "cannot be made without arguments"),
    ],
)
def test_an_own_class_that_cannot_be_used_is_refused(own, name, message):
    with pytest.raises(InputError, match=message):
        load_agent(name)


def test_a_kinematic_system_is_evaluated_without_physics(library, tmp_path, capsys):
    out = tmp_path / "scores"
    assert evaluate(EvaluateArgs("ik", library, out=out, threads=1)) == 0
    written = json.loads((out / "metrics.json").read_text())
    assert 0.0 < written["all"]["mpjpe_cm"] < 3.0 and written["all"]["success"] == 1.0
    assert written["context"]["config"]["physics"] is False
    assert "pelvis_tracker" in written["context"]["config"]["devices"]
    with pytest.raises(InputError, match="--sensors"):
        evaluate(EvaluateArgs("ik", library, sensors="H", threads=1))


def test_an_own_kinematic_system_takes_the_place_of_a_shipped_one(own, library):
    assert resolve("own_system:Mine").kind == "system"
    assert resolve("own_system:Mine+physics").base == "own_system:Mine"
    assert isinstance(load_driver("own_system:Mine", lambda name: MOTION), PoseDriver)
    figures = []
    for name in ("ik", "own_system:Mine"):
        out = own / name[:3]
        assert evaluate(EvaluateArgs(name, library, out=out, threads=1)) == 0
        figures.append(json.loads((out / "metrics.json").read_text())["all"]["mpjpe_cm"])
    assert figures[0] == figures[1]
    assert load_system("own_system:Mine").name == "mine"


def test_shipped_agents_are_compared_in_the_order_of_the_tables():
    names = shipped_agents()
    published = ["avatarposer", "hmdposer", "lgsik", "sparseposer", "dragposer"]
    assert names[:7] == ["ik", *published, "lgsik-lengths"]
    assert names[7:14] == [f"{name}{PHYSICS}" for name in names[:7]]
    assert names[14:] == ["questsim", "questsim-headset", "questsim-now"]


def test_random_agents_of_a_name_are_new_each_time():
    first, second = load_agent("random"), load_agent("random")
    assert first is not second
    np.testing.assert_array_equal(first.act(np.zeros((2, 1))), second.act(np.zeros((2, 1))))
