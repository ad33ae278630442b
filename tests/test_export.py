"""The exported graph gives the torques that the environment and the policy give."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from helpers import swaying_clip

from agents.agent import Needs
from agents.policy import export as export_module
from agents.policy.checkpoint import save_policy
from agents.policy.export import ExportArgs, export, metadata
from agents.policy.observation_module import SparseObservation, heading
from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import TRACKER_BLOCKS, Layout, PolicySpec
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.layout import observation_layout, observation_size
from questsim import cli, rotations
from questsim.body import build_body
from questsim.errors import InputError
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.skeleton import DOFS, LINKS, NUM_DOFS, NUM_LINKS

HEIGHTS_M = (1.40, 1.75, 2.00)
YAWS_RAD = (0.4, -2.2, 3.1)
CASES = [("H+2C", 6, "default"), ("H", 0, "paper")]
"""Sensors, future frames and body of the policies that are exported."""


def turned_clip(height_m: float, yaw: float) -> Clip:
    """A swaying avatar that faces ``yaw`` and stands metres away from the origin."""
    sway = swaying_clip(height_m=height_m, frames=20)
    qpos = sway.qpos.copy()
    qpos[:, :2] += 3.0 * np.array([np.cos(yaw), -np.sin(yaw)])
    qpos[:, 3:7] = rotations.quat_multiply(rotations.yaw_quat(np.array(yaw)), qpos[:, 3:7])
    return clip_from_qpos(f"{height_m}", qpos, height_m, kind="stand", licence="MIT")


CLIPS = [turned_clip(height, yaw) for height, yaw in zip(HEIGHTS_M, YAWS_RAD, strict=True)]


def agent_for(config: EnvConfig, **changes) -> PolicyAgent:
    """A policy whose torques depend strongly on everything it sees."""
    torch.manual_seed(1)
    shape = {"critic_blocks": (), "hidden": (64, 32), "activation": "elu"}
    if changes.get("torque_head", True) and config.body_preset == "default":
        shape["balance"] = "placement"
    spec = PolicySpec(**shape | changes)
    layout = Layout.of(observation_layout(config)).within(spec.actor_blocks)
    policy = new_policy(spec, layout, gains=np.linspace(0.2, 2.0, NUM_DOFS))
    norm = policy.actor.norm
    norm.mean.copy_(torch.randn_like(norm.mean) * 0.3)
    norm.var.copy_(torch.rand_like(norm.var) + 0.1)
    last = policy.actor.layers[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.weight.mul_(20.0)
    needs = Needs(config.sensors, config.future_frames, config.privileged, config.body_preset)
    return PolicyAgent(policy, needs, "tested")


def moving_sim(config: EnvConfig, steps: int = 3) -> BatchSim:
    """Avatars of several heights that fall about, so that velocities and forces are not zero."""
    sim = BatchSim(CLIPS, replace(config, fixed_start=True))
    sim.reset()
    rng = np.random.default_rng(0)
    for _ in range(steps):
        sim.step(rng.uniform(-0.3, 0.3, (len(CLIPS), NUM_DOFS)))
    return sim


def raw_state(sim: BatchSim) -> dict[str, np.ndarray]:
    """What any MuJoCo program can read, and the devices of the coming frames in the world."""
    states = []
    for i, height in enumerate(sim.heights):
        model = build_body(float(height), sim.config.body_preset).model
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = sim.qpos[i], sim.qvel[i]
        mujoco.mj_forward(model, data)
        states.append(state_of(model, data) | devices_of(sim, i))
    together = {name: np.concatenate([state[name] for state in states]) for name in states[0]}
    return together | {"contact_force": sim.contact_force.astype(np.float32)}


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, np.ndarray]:
    """The simulator's inputs of the graph for one avatar, as docs/export.md reads them."""
    velocity = np.zeros((NUM_LINKS, 6))
    for link in range(NUM_LINKS):
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(model, data, kind, link + 1, velocity[link], 0)
    return batch_of_one(
        qpos=data.qpos,
        link_position=data.xpos[1:],
        link_quat=data.xquat[1:],
        qvel=data.qvel,
        link_velocity=velocity[:, 3:],
        link_angular_velocity=velocity[:, :3],
        contact_force=-data.sensordata.reshape(2, 3),
    )


def devices_of(sim: BatchSim, i: int) -> dict[str, np.ndarray]:
    """The user's inputs of the graph for avatar ``i``."""
    rows = sim.frame[i] + np.array(sim.config.frame_offsets)
    height = sim.heights[i]
    return batch_of_one(
        device_position=sim.reference.dev_position[rows] * (height / 1.75),
        device_quat=sim.reference.dev_quat[rows],
        height_m=np.array([height]),
    )


def batch_of_one(**arrays: np.ndarray) -> dict[str, np.ndarray]:
    return {name: np.asarray(array, np.float32)[None] for name, array in arrays.items()}


def exported(agent: PolicyAgent, folder: Path, **training) -> Path:
    """The file that the command writes for an agent saved to disk."""
    save_policy(folder / "policy", agent.policy, agent.needs, training)
    assert export(ExportArgs(str(folder / "policy"), folder / "policy.onnx")) == 0
    return folder / "policy.onnx"


def rows_of(state: dict[str, np.ndarray], rows: list[int]) -> dict[str, np.ndarray]:
    return {name: array[rows] for name, array in state.items()}


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[tuple[str, int, str], Path]:
    """Exports made so far, by sensors, future frames and body: each takes seconds."""
    made: dict[tuple[str, int, str], Path] = {}
    for sensors, frames, preset in CASES:
        config = EnvConfig(sensors=sensors, future_frames=frames, body_preset=preset)
        folder = tmp_path_factory.mktemp("export")
        made[sensors, frames, preset] = exported(
            agent_for(config), folder, licences={"CC-BY-NC-4.0": 3, "MIT": 1}
        )
    return made


@pytest.mark.parametrize(("sensors", "frames", "preset"), CASES)
def test_graph_gives_the_torques_of_environment_and_policy(files, sensors, frames, preset):
    config = EnvConfig(sensors=sensors, future_frames=frames, body_preset=preset)
    agent, sim = agent_for(config), moving_sim(config)
    action = agent.act(sim.observation)
    assert np.abs(sim.contact_force).max() > 50.0
    assert 0.1 < np.abs(action).mean() < 0.9
    session = onnxruntime.InferenceSession(files[sensors, frames, preset])
    state = raw_state(sim)
    for rows in ([0, 1, 2], [2], [0, 1, 2, 1, 0, 2, 2]):
        (torque,) = session.run(["torque"], rows_of(state, rows))
        limits = sim.torque_limits[rows]
        np.testing.assert_allclose(torque / limits, action[rows], rtol=0, atol=1e-5)


def test_height_in_centimetres_is_clamped_and_lost_tracking_gives_no_torques(files):
    config = EnvConfig()
    sim = moving_sim(config)
    session = onnxruntime.InferenceSession(files["H+2C", 6, "default"])

    def torque(**changes):
        return session.run(["torque"], raw_state(sim) | changes)[0]

    tall = np.full((3, 1), 175.0, np.float32)
    np.testing.assert_allclose(torque(height_m=tall), torque(height_m=np.full_like(tall, 2.2)))  # type: ignore
    assert (abs(torque(height_m=tall)) <= build_body(2.2).torque_limits * 1.0001).all()  # type: ignore
    lost = raw_state(sim)["device_position"].copy()
    lost[1, 2, 0, 1] = np.nan
    lost[2, 0, 1] = np.inf
    given = torque(device_position=lost)
    np.testing.assert_array_equal(given[0], torque()[0])  # type: ignore
    np.testing.assert_array_equal(given[1:], 0.0)  # type: ignore


def test_graph_drives_a_plain_simulator_as_the_policy_drives_the_environment(files):
    config = EnvConfig()
    agent, sim = agent_for(config), moving_sim(config, steps=0)
    session = onnxruntime.InferenceSession(files["H+2C", 6, "default"])
    body = build_body(HEIGHTS_M[0])
    data = mujoco.MjData(body.model)
    data.qpos[:], data.qvel[:] = sim.qpos[0], sim.qvel[0]
    mujoco.mj_step1(body.model, data)
    hardest = 0.0
    for _ in range(5):
        inputs = state_of(body.model, data) | devices_of(sim, 0)
        data.ctrl[:] = np.asarray(session.run(["torque"], inputs)[0])[0]
        mujoco.mj_step(body.model, data, body.substeps)
        mujoco.mj_step1(body.model, data)
        sim.step(agent.act(sim.observation))
        force = sim.contact_force[0]
        np.testing.assert_allclose(data.qpos, sim.qpos[0], atol=1e-3)
        np.testing.assert_allclose(-data.sensordata, force.ravel(), atol=5.0)
        hardest = max(hardest, float(force.max()))
    assert hardest > 100.0


def test_observation_module_is_the_environments_observation():
    sim = moving_sim(EnvConfig())
    module = SparseObservation(frames=6, devices=3)
    state = {name: torch.from_numpy(array) for name, array in raw_state(sim).items()}
    assert list(state) == list(module.shapes())
    assert {name: tuple(array.shape[1:]) for name, array in state.items()} == module.shapes()
    found = module(*state.values()).numpy()
    assert found.shape == (3, observation_size(sim.layout))
    for name, part in sim.layout.items():
        np.testing.assert_allclose(
            found[:, part], sim.observation[:, part], rtol=1e-5, atol=1e-5, err_msg=name
        )


def test_root_that_lies_on_its_back_has_a_heading():
    upright = torch.tensor([[np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0]], dtype=torch.float64)
    cos, sin = heading(upright)
    assert (cos.item(), sin.item()) == (1.0, 0.0)


def test_file_says_what_its_arrays_mean(files):
    path = files["H+2C", 6, "default"]
    said = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    assert said["format"] == "questsim-onnx"
    assert said["format_version"] == "1"
    assert said["dofs"].split(",") == list(DOFS)
    assert said["links"].split(",") == list(LINKS)
    assert said["devices"] == "headset,left_controller,right_controller"
    assert said["frame_offsets"] == "1,2,3,4,5,6"
    assert said["licence"] == "CC-BY-NC-4.0"
    assert (said["fps"], said["body_preset"]) == ("36", "default")


def test_present_frame_alone_is_said_to_be_frame_0():
    agent = agent_for(EnvConfig(sensors="H", future_frames=0))
    assert metadata(agent)["frame_offsets"] == "0"
    assert metadata(agent)["licence"] == "not stated"


def test_file_holds_no_path_of_the_machine_it_was_made_on(files):
    content = files["H+2C", 6, "default"].read_bytes()
    root = Path(__file__).parents[1]
    assert str(root).encode() not in content
    assert b".py" not in content


def test_teacher_is_refused_by_name(tmp_path):
    config = EnvConfig(privileged=True)
    agent = agent_for(config, actor_blocks=TRACKER_BLOCKS, reference_head=True)
    with pytest.raises(InputError, match=r"tested: reads privileged.*students"):
        export_module.write_onnx(agent, tmp_path / "x.onnx")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["zero", "random"])
def test_agents_without_a_policy_are_refused(name, tmp_path, capsys):
    words = ["export", "--agent", name, "--format", "onnx", "--out", str(tmp_path / "x.onnx")]
    assert cli.main(words) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"error: {name}: is not a torque policy; ") and "questsim" in line
    assert line.count("\n") == 1


def test_policy_of_another_observation_is_refused(tmp_path):
    agent = agent_for(EnvConfig(future_frames=6))
    save_policy(tmp_path / "policy", agent.policy, Needs(future_frames=0), {})
    with pytest.raises(InputError, match="162 numbers of 'o_user'"):
        export(ExportArgs(str(tmp_path / "policy"), tmp_path / "x.onnx"))
    assert not (tmp_path / "x.onnx").exists()


def test_folder_that_is_missing_is_refused_before_the_work(tmp_path):
    agent = agent_for(EnvConfig())
    save_policy(tmp_path / "policy", agent.policy, agent.needs, {})
    with pytest.raises(InputError, match="name a file in an existing folder"):
        export(ExportArgs(str(tmp_path / "policy"), tmp_path / "no" / "x.onnx"))


def test_missing_packages_are_named(tmp_path, monkeypatch):
    agent = agent_for(EnvConfig())
    save_policy(tmp_path / "policy", agent.policy, agent.needs, {})
    monkeypatch.setattr(export_module, "NEEDED_PACKAGES", ("onnx", "package_that_is_not_there"))
    with pytest.raises(InputError, match=r"package_that_is_not_there.*questsim\[export\]"):
        export(ExportArgs(str(tmp_path / "policy"), tmp_path / "x.onnx"))
