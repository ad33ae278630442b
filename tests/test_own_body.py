"""Bodies of the user's own: description, rest pose, retargeting, environments, policies."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import envs  # noqa: F401  # registers the ids
from agents.agent import Needs, RandomAgent, ZeroAgent
from agents.commands.evaluate import evaluate as evaluate_command
from agents.evaluation.options import EvaluateArgs
from agents.evaluation.rollout import env_config, roll_out
from agents.follower.engines import TorqueEngine
from agents.policy.checkpoint import load_policy, save_policy
from agents.policy.policy_agent import PolicyAgent, new_policy
from agents.policy.spec import Layout, PolicySpec
from agents.training import train_policy
from agents.training.options import TrainArgs
from agents.training.training_clips import load_clips
from envs.config import EnvConfig
from envs.core import BatchSim
from envs.objects import objects_named
from envs.terrain import terrain_named
from questsim import rotations as rot
from questsim.bodies import clip_for, map_of, read_body
from questsim.bodies.retarget import clip_of_poses, poses_of
from questsim.bodies.torques import own_torques
from questsim.errors import InputError
from questsim.metrics import evaluate
from questsim.motion.clip import Clip
from questsim.motion.kinematics import clip_from_qpos, sole_points
from questsim.motion.spec import load_motions
from questsim.skeleton import FOOT_LINKS, LINKS
from questsim.viewing import gl
from questsim.viewing.films import rollout_frames

ROBOT, GYMNASIUM = Path(__file__).parent / "bodies" / "robot.toml", "gymnasium-humanoid"
SIDES = ("left", "right")


@pytest.fixture(scope="module")
def walk() -> Clip:
    clip = load_motions("synthetic:walk")[0]
    return clip_from_qpos("walk", clip.qpos[60:110], clip.height_m, kind="walk")


def write(folder: Path, mjcf: str = "questsim", more: str = "") -> Path:
    path = folder / "own.toml"
    path.write_text(f'name = "own"\nmjcf = "{mjcf}"\n{more}', encoding="utf-8")
    return path


def with_toes(folder: Path) -> Path:
    """Our skeleton with a hinge and a capsule for the toes of each foot."""
    text = (Path(__file__).parents[1] / "assets/mjcf/humanoid.xml").read_text(encoding="utf-8")
    for side in SIDES:
        toes = (
            f'<body name="{side}_toes" pos="0.13 0 -0.046">'
            f'<joint name="{side}_toes_y" axis="0 1 0" range="-60 10" damping="0.5"/>'
            f'<geom name="{side}_toes" type="capsule" fromto="0.02 -0.02 0 0.02 0.02 0"'
            ' size="0.022" mass="0.1"/></body>'
        )
        text = re.sub(rf'<geom name="{side}_toes"[^>]*/>', toes, text)
        motor = f'<motor name="{side}_toes_y" joint="{side}_toes_y" ctrlrange="-20 20"/>'
        text = text.replace("</actuator>", f"{motor}</actuator>")
    (folder / "toes.xml").write_text(text, encoding="utf-8")
    names = [*LINKS, "left_toes", "right_toes"]
    return write(folder, "toes.xml", "[links]\n" + "\n".join(f'{n} = "{n}"' for n in names))


def limb_angles(body, own: Clip, clip: Clip) -> dict[str, float]:
    """Mean angle in degrees between the limbs' directions on the body and the avatar."""
    position, _ = body.roles(own.link_position, own.link_quat)
    found = {}
    for side in SIDES:
        for upper, lower in (("thigh", "shin"), ("shin", "foot"), ("upper_arm", "forearm")):
            a, b = LINKS.index(f"{side}_{upper}"), LINKS.index(f"{side}_{lower}")
            one, two = position[:, b] - position[:, a], clip.link_position[:, b]
            two = two - clip.link_position[:, a]
            cosine = (one * two).sum(-1) / np.linalg.norm(one, axis=-1)
            angle = np.arccos(np.clip(cosine / np.linalg.norm(two, axis=-1), -1, 1))
            found[f"{side}_{upper}"] = float(np.degrees(angle.mean()))
    return found


def test_our_skeleton_with_other_masses_follows_our_clips_to_a_degree(tmp_path, walk):
    own = read_body(write(tmp_path, more="[masses]\nchest = 20\n[torque_limits]\nneck_y = 7\n"))
    body = map_of(own)
    assert body.body.model.body("chest").mass[0] == pytest.approx(20.0)
    assert body.body.torque_limits[body.dofs.index("neck_y")] == 7.0
    assert body.body.torque_limits[body.dofs.index("left_hip_y")] == 200.0
    found = clip_for(own, walk)
    assert np.degrees(rot.angle_between(found.link_quat, walk.link_quat)).max() < 1.0
    assert np.abs(found.link_position - walk.link_position).max() < 0.01


def test_toes_lie_flat_while_the_heel_rises(tmp_path, walk):
    own = read_body(with_toes(tmp_path))
    body, clip = map_of(own), clip_for(own, walk)
    foot = walk.link_quat[:, FOOT_LINKS[0]]
    pitch = np.degrees(rot.as_rotation(foot).as_euler("zyx")[:, 1])
    points = sole_points()[0]
    ball = rot.quat_rotate(foot, points[points[:, 0].argmax()])
    ball += walk.link_position[:, FOOT_LINKS[0]]
    lifted = (pitch > 15.0) & (ball[:, 2] < 0.03)
    assert lifted.sum() >= 2  # heel-off is in the walk
    up = rot.quat_rotate(clip.link_quat[:, body.links.index("left_toes")], np.array([0, 0, 1.0]))
    assert np.degrees(np.arccos(up[lifted, 2])).mean() < 8.0
    bend = clip.qpos[:, 7 + body.dofs.index("left_toes_y")]
    assert np.degrees(bend[lifted]).mean() < -10.0


@pytest.mark.parametrize("name", [GYMNASIUM, ROBOT], ids=["gymnasium", "robot"])
def test_other_humanoids_stand_at_rest_and_walk_as_the_avatar_does(name, walk):
    body = map_of(read_body(name))
    position, quat = poses_of(body, body.rest[None])
    roles, turn = body.roles(position[0], quat[0])
    for side in SIDES:  # arms hang, though both models hold them otherwise in their zero pose
        arm, hand = (roles[LINKS.index(f"{side}_{part}")] for part in ("upper_arm", "hand"))
        assert hand[2] < arm[2] and np.linalg.norm((hand - arm)[:2]) < 0.05
    assert rot.angle_between(turn, np.array([1.0, 0, 0, 0])).max() < np.radians(12)
    assert body.support.lowest(position, quat) == pytest.approx(0.0, abs=1e-3)
    clip = clip_for(read_body(name), walk)
    assert max(limb_angles(body, clip, walk).values()) < 20.0
    lowest = body.support.lowest(clip.link_position, clip.link_quat)
    assert lowest.min() > -1e-6 and lowest.min(axis=1).max() < 0.02
    travelled = np.ptp(clip.qpos[:, 0]) / np.ptp(walk.qpos[:, 0])
    assert 0.6 < travelled < 1.0
    assert np.abs(clip.qvel[:, 6:]).max() < 15.0  # no jumps


def test_every_size_of_the_task_follows_from_the_map(walk):
    env = gym.make("QuestSim-v0", motions=[walk], body=str(ROBOT), privileged=True)
    sim = env.unwrapped.sim  # type: ignore[attr-defined]
    links, dofs = len(sim.avatar.links), len(sim.avatar.dofs)
    assert (links, dofs) == (23, 22) and env.action_space.shape == (22,)
    sparse, teacher = 2 * dofs + 15 * links + 6 + 6 * 3 * 9 + 1, 6 * dofs + 30 * links
    assert env.observation_space.shape == (sparse + teacher,)
    obs, info = env.reset(seed=0, options={"clip": 0, "frame": 0})
    first = sim.reference.qpos[0]
    np.testing.assert_allclose(obs[:dofs], first[7:], atol=1e-6)
    assert info["error_m"] < 0.01 and np.isfinite(obs).all()
    total, loaded = 0.0, 0.0
    for _ in range(8):
        obs, reward, _, _, info = env.step(np.zeros(22, np.float32))
        assert np.isfinite(obs).all() and 0.0 < float(reward) <= 1.0
        total, loaded = total + float(reward), max(loaded, info["foot_force_n"][:, 2].max())
    weight = 9.81 * sim.body.model.body_mass.sum()
    assert 0.2 * weight < loaded < 20 * weight
    env.close()


def test_the_headset_is_worn_on_the_place_that_the_map_calls_the_head(walk):
    body = read_body(GYMNASIUM)
    sim = BatchSim([walk], EnvConfig(body=body), 1)
    torso = clip_for(body, walk)
    size = map_of(body).body.height_m / 1.75
    offset = np.array([0.0, 0.0, 0.12]) + size * np.array([0.12, 0.0, 0.19])
    want = torso.link_position[:, 0] + rot.quat_rotate(torso.link_quat[:, 0], offset)
    np.testing.assert_allclose(sim.reference.dev_position[:, 0], want, atol=1e-3)
    sim.close()


def test_torques_of_inverse_dynamics_carry_the_weight_at_rest():
    body = map_of(read_body(ROBOT))
    still = clip_of_poses(
        body, np.repeat(body.rest[None], 3, axis=0), load_motions("synthetic:stand")[0]
    )
    torque = own_torques(read_body(ROBOT), [still])[1]
    knees = [body.dofs.index(f"{side}_knee_joint") for side in SIDES]
    assert np.abs(torque[knees]).max() < 0.15  # straight legs carry the weight, not the knees
    elbows = [body.dofs.index(f"{side}_elbow_joint") for side in SIDES]
    assert np.abs(torque[elbows]).max() < 0.05


@pytest.mark.parametrize("file", [ROBOT, GYMNASIUM])
def test_a_chair_carries_the_thighs_of_a_seated_clip(file):
    whole = load_motions("synthetic:sit")[0]
    lowest = int(whole.qpos[:, 2].argmin())
    seated = np.repeat(whole.qpos[lowest : lowest + 1], 3, axis=0)
    clip = clip_for(read_body(file), clip_from_qpos("sit", seated, whole.height_m, kind="sit"))
    body = map_of(read_body(file))
    hinges = [i for i, name in enumerate(body.dofs) if "knee" in name]
    on_chair = np.abs(own_torques(read_body(file), [clip])[:, hinges]).max()
    crouched = np.abs(own_torques(read_body(file), [replace(clip, kind="squat")])[:, hinges]).max()
    assert on_chair < 0.6 * crouched


@pytest.mark.parametrize("name", [GYMNASIUM, ROBOT], ids=["gymnasium", "robot"])
def test_feet_of_another_body_stand_on_uneven_ground_as_on_the_floor(name, walk):
    body = read_body(name)
    own, level = map_of(body), clip_for(body, walk)
    high = own.support.lowest(level.link_position, level.link_quat)
    stands = high < 0.005
    for terrain in ("slope:slope_deg=6", "rough", "rough:amplitude_m=0"):
        config = EnvConfig(body=body, terrain=terrain_named(terrain, "terrain"))
        sim = BatchSim([walk], config, 1, seed=1)
        sim.reset(clip=0)
        field, placed = sim.placement.field, sim.placed_clip(0, walk)
        # Its links are where its hinges put them, and no hinge is beyond its range.
        np.testing.assert_allclose(
            poses_of(own, placed.qpos)[0], placed.link_position, rtol=0, atol=1e-5
        )
        angles = placed.qpos[:, 7:]
        assert (angles > own.joint_range[:, 0] - 0.01).all()
        assert (angles < own.joint_range[:, 1] + 0.01).all()
        above = own.support.lowest(placed.link_position, placed.link_quat, field)
        assert np.abs(above - high)[stands].max() < 0.01 and above.min() > -0.01
        changed = np.abs(angles - level.qpos[:, 7:]).max()
        assert changed < 1e-3 if terrain.endswith("=0") else changed > 0.02
        assert sim.error[0] < 0.01 and sim.foot_clearance.min() > -1e-6
        for _ in range(5):
            sim.step(np.zeros((1, len(own.dofs))))
        assert np.isfinite(sim.observation).all() and not sim.unstable.any()
        assert sim.error[0] < 0.1
        sim.close()


def test_bodies_of_several_heights_follow_their_scaled_clips(walk):
    body = read_body(ROBOT)
    own = map_of(body)
    sim = BatchSim([walk], EnvConfig(body=body, heights=(1.2, 1.6)), 2, seed=1)
    sim.reset(clip=0, frame=5)
    ratio = np.array([1.2, 1.6]) / own.body.height_m
    weight = own.body.model.body_mass[1:].sum()
    assert sim.masses == pytest.approx(weight * ratio**3)
    assert sim.torque_limits[1] == pytest.approx(own.body.torque_limits * ratio[1] ** 3)
    assert sim.error.max() < 1e-3 and np.abs(sim.foot_clearance).max() < 0.05
    level = clip_for(body, walk)
    for i in range(2):
        want = level.link_position[5] * ratio[i]
        np.testing.assert_allclose(sim.link_positions[i], want, atol=1e-4)
        placed = sim.placed_clip(i, walk)
        assert placed.height_m == pytest.approx((1.2, 1.6)[i])
        head = sim.avatar.our_links(placed.link_position, placed.link_quat, placed.height_m)[0]
        ours, _ = own.roles(level.link_position, level.link_quat)
        np.testing.assert_allclose(head, ours * ratio[i], atol=1e-4)
    assert np.diff(sim.observation[:, sim.layout["o_scale"]], axis=0)[0] == pytest.approx(0.4)
    sim.close()


@pytest.mark.parametrize("name", [GYMNASIUM, ROBOT], ids=["gymnasium", "robot"])
def test_another_body_pushes_an_object_and_feels_it(name, walk):
    body = read_body(name)
    config = EnvConfig(body=body, objects=objects_named(["ball"]))
    sim = BatchSim([walk], config, 1, seed=1)
    sim.reset(clip=0)
    apart = np.linalg.norm(sim.objects.pose[0, 0, :2] - sim.qpos[0, :2])
    assert apart > 0.5 and not sim.objects.force.any()
    shin = sim.link_positions[0, sim.avatar.link("left_shin")]
    before = shin + np.array([0.16, 0.0, -0.2])  # the leg swings forward
    sim.objects.pose[0, 0, :3] = before
    pushed = 0.0
    for _ in range(2):
        sim.step(np.zeros((1, len(sim.avatar.dofs))))
        pushed = max(pushed, float(sim.objects.force[0, 0, 0]))
    assert sim.objects.pose[0, 0, 0] > before[0] + 0.005 and pushed > 1.0
    sim.close()


def test_evaluation_compares_our_links_on_the_other_body(walk):
    config = env_config(ZeroAgent(), body=GYMNASIUM)
    for agent in (ZeroAgent(), RandomAgent()):
        (rollout,) = roll_out(agent, [walk], config)
        figures = evaluate([rollout])["all"]
        assert rollout.link_position.shape[1:] == (16, 3) and rollout.joint_angles.shape[1] == 17
        assert 1.0 < figures["mpjpe_cm"] < 50.0 and figures["mhpe_cm"] is not None
    start = rollout.link_position[0] - rollout.reference.link_position[0]
    assert np.abs(start).max() < 0.01


@pytest.mark.skipif(gl.find_gl() is None, reason=gl.missing_gl())
def test_a_rollout_of_another_body_is_filmed_in_the_poses_of_its_own_links(walk):
    agent = ZeroAgent()
    config = env_config(agent, body=GYMNASIUM)
    (rollout,) = roll_out(agent, [walk], config)
    assert config.body is not None
    body = map_of(config.body)
    assert rollout.qpos.shape == (len(rollout), 7 + len(body.dofs))
    # The root is the torso, whose links carry our pelvis.
    position, _ = body.roles(*poses_of(body, rollout.qpos))
    np.testing.assert_allclose(position, rollout.link_position, atol=1e-3)
    assert rollout.root is not None
    moved = rollout.root + np.array([9.0, 9.0, 9.0, 0.0, 0.0, 0.0, 0.0], np.float32)
    picture = next(rollout_frames([rollout], 320, 240, 1))
    empty = next(rollout_frames([replace(rollout, root=moved)], 320, 240, 1))
    assert picture.shape == (240, 320, 3)
    assert (picture != empty).any(axis=-1).mean() > 0.02


def test_a_policy_is_refused_on_another_body_in_one_line_and_acts_on_its_own(tmp_path, walk):
    own = read_body(GYMNASIUM)
    theirs = BatchSim([walk], EnvConfig(body=own), 1)
    ours = BatchSim([walk], EnvConfig(), 1)
    layout = Layout.of(theirs.layout)
    policy = new_policy(PolicySpec(hidden=(8,), critic_blocks=()), layout, hinges=17)
    save_policy(tmp_path / "p", policy, Needs(body=own), {})
    agent = load_policy(tmp_path / "p")
    agent.bind(theirs)
    theirs.reset()
    assert agent.act(theirs.observation).shape == (1, 17)
    with pytest.raises(
        InputError, match=r"trained for the body 'gymnasium-humanoid', not for ours"
    ):
        agent.bind(ours)
    shipped = PolicyAgent(
        new_policy(PolicySpec(hidden=(8,), critic_blocks=()), Layout.of(ours.layout)), Needs()
    )
    with pytest.raises(InputError, match="our own body, not for 'gymnasium-humanoid'") as refused:
        shipped.bind(theirs)
    assert "\n" not in str(refused.value)
    assert env_config(agent).body == own  # evaluation takes the policy's own body
    ours.close()
    theirs.close()


def test_a_training_says_how_to_film_a_body_that_the_page_cannot_show(tmp_path, monkeypatch):
    monkeypatch.setattr(train_policy, "find_policy", lambda out: out / "best")
    ours = train_policy._outcome(TrainArgs(tmp_path))
    theirs = train_policy._outcome(TrainArgs(tmp_path, body=GYMNASIUM))
    assert "questsim play" in ours and "questsim play" not in theirs
    assert theirs.endswith(f"--out {tmp_path}/scores --video")


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"assist": 100.0}, "--assist: .*its forces are made for our avatar's legs and trunk"),
        ({"save_motion": "bvh"}, "--save-motion: .*these files have our avatar's skeleton"),
        ({"own_proportions": True}, "--own-proportions: .*the body keeps its own proportions"),
    ],
)
def test_an_evaluation_says_why_an_option_is_our_avatars_alone(given, what, tmp_path):
    args = EvaluateArgs(agent="zero", body=GYMNASIUM, out=tmp_path / "scores", **given)
    with pytest.raises(InputError, match=what) as refused:
        evaluate_command(args)
    assert "\n" not in str(refused.value) and not (tmp_path / "scores").exists()


def test_a_training_of_another_body_refuses_the_performers_proportions(tmp_path):
    args = TrainArgs(tmp_path / "run", body=GYMNASIUM, own_proportions=True)
    with pytest.raises(InputError, match="--own-proportions: does not go with a body of your own"):
        load_clips(args)


def test_a_stream_refuses_a_policy_of_another_body_before_it_begins(walk):
    own = read_body(GYMNASIUM)
    sim = BatchSim([walk], EnvConfig(body=own), 1)
    spec = PolicySpec(hidden=(8,), critic_blocks=())
    policy = new_policy(spec, Layout.of(sim.layout), hinges=17)
    sim.close()
    with pytest.raises(InputError, match="'gymnasium-humanoid', and a device stream drives only"):
        TorqueEngine(PolicyAgent(policy, Needs(body=own), "mine"))


def robot_with(folder: Path, old: str, new: str) -> str:
    text = (ROBOT.parent / "robot.xml").read_text(encoding="utf-8")
    assert old in text
    (folder / "robot.xml").write_text(text.replace(old, new), encoding="utf-8")
    path = folder / "robot.toml"
    path.write_text(ROBOT.read_text(encoding="utf-8"), encoding="utf-8")
    return str(path)


def test_what_cannot_be_used_is_refused_in_one_line(tmp_path, walk):
    base = ROBOT.read_text(encoding="utf-8")
    (tmp_path / "robot.xml").write_bytes((ROBOT.parent / "robot.xml").read_bytes())
    cases = {
        'pelvis = "pelvis"': ('pelvis = "hip"', "no body 'hip'"),
        'name = "robot"': ('nam = "robot"', "there is no field 'nam' .did you mean name"),
        'chest = "torso_link"': ('ches = "torso_link"', "did you mean chest"),
        'left_shin = "left_knee_link"\n': ("", "lacks left_shin"),
        "at = [0.18, 0.0, 0.0]": ("at = [0.18, 0.0]", "not three numbers"),
        'mjcf = "robot.xml"': ('mjcf = "gone.xml"', "there is no file of mjcf 'gone.xml'"),
        "at = [0.18, 0.0, 0.0": ("at = " + 2000 * "[", "description of a body cannot be read"),
        "\n\n[links]": ("\nsubsteps = 0\n[links]", "substeps is 0"),
        "\n\n[links]\n": ("\n[torque_limits]\nknee = 3\n[links]\n", "no hinge 'knee'"),
    }
    for old, (new, message) in cases.items():
        assert old in base
        path = tmp_path / "case.toml"
        path.write_text(base.replace(old, new), encoding="utf-8")
        with pytest.raises(InputError, match=message) as refused:
            read_body(path)
        assert "\n" not in str(refused.value)
    for old, new, message in (
        ('axis="0 1 0" range="-0.08 2.8"', 'axis="0 1 0" type="slide" range="-0.08 2.8"', "hinge"),
        ('range="-0.08 2.8" actuatorfrcrange="-139 139"', 'range="-0.08 2.8"', "no motor with a"),
        ('<freejoint name="floating_base_joint"/>', "", "0 free joints"),
    ):
        with pytest.raises(InputError, match=message):
            read_body(robot_with(tmp_path, old, new))
    for field, value in (("unscaled_m", 0.1), ("proportions", 0.05), ("body_preset", "paper")):
        options: dict[str, Any] = {field: value}
        with pytest.raises(InputError, match=f"{field} does not go with a body of your own"):
            gym.make("QuestSim-v0", motions=[walk], body=GYMNASIUM, **options)
