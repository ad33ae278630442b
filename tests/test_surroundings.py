"""Pushes, objects and imperfect devices, and that flat worlds know nothing of them."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from helpers import swaying_clip
from test_terrain import HILLS, gliding_clip

from envs import BatchSim, EnvConfig, Pushes, QuestVecEnv, Randomisation, WorldObject
from envs.object_places import APART_M, CLEARANCE_M
from envs.objects import OBJECTS
from questsim import rotations as rot
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.skeleton import LINKS

CLIPS = [swaying_clip("a", 1.75), swaying_clip("b", 1.6, frames=50)]
NOTHING = np.zeros((2, 33))
PUSH = Pushes((100.0, 100.0), (0.2, 0.2), (0.5, 0.5), count=1)


def pushed_steps(config: EnvConfig, steps: int = 45, seed: int = 0) -> tuple[BatchSim, np.ndarray]:
    sim = BatchSim(CLIPS, replace(config, fixed_start=True, max_error_m=99.0), seed=seed)
    sim.reset()
    forces = []
    for _ in range(steps):
        sim.step(NOTHING)
        forces.append(sim.pusher.force.copy())
    return sim, np.array(forces)


def test_a_push_has_its_time_force_and_impulse() -> None:
    _, forces = pushed_steps(EnvConfig(pushes=PUSH))
    strength = np.linalg.norm(forces, axis=-1)
    assert (strength[:18] == 0.0).all() and (strength[26:] == 0.0).all()
    np.testing.assert_allclose(strength[18:25], 100.0)
    np.testing.assert_allclose(strength.sum(axis=0) / FPS, 100.0 * 0.2)
    assert (forces[..., 2] == 0.0).all()
    assert not np.allclose(forces[20, 0], forces[20, 1])


def test_a_push_moves_the_chest_its_way() -> None:
    pushed, forces = pushed_steps(EnvConfig(pushes=PUSH), steps=26)
    alone, _ = pushed_steps(EnvConfig(), steps=26)
    chest = LINKS.index("chest")
    moved = (pushed.link_positions - alone.link_positions)[:, chest]
    for i in range(2):
        along = forces[20, i] / np.linalg.norm(forces[20, i])
        # 100 N on 70 kg for 0.2 s come to 2.9 cm; the chest alone is lighter, the feet hold back.
        assert 0.01 < moved[i] @ along < 0.3


def test_pushes_come_again_until_their_count_and_follow_the_seed() -> None:
    often = Pushes((20.0, 40.0), (0.05, 0.1), (0.1, 0.2), count=3)
    _, forces = pushed_steps(EnvConfig(pushes=often))
    on = np.linalg.norm(forces, axis=-1) > 0.0
    begins = on & ~np.vstack([np.zeros((1, 2), bool), on[:-1]])
    assert begins.sum(axis=0).tolist() == [3, 3]
    np.testing.assert_array_equal(pushed_steps(EnvConfig(pushes=often))[1], forces)
    assert not np.array_equal(pushed_steps(EnvConfig(pushes=often), seed=1)[1], forces)


def test_a_push_by_hand_acts_at_once_and_ends() -> None:
    sim = BatchSim(CLIPS, EnvConfig(fixed_start=True))
    sim.reset()
    sim.pusher.push(1, np.array([0.0, 50.0, 0.0]), 0.1)
    forces = []
    for _ in range(6):
        sim.step(NOTHING)
        forces.append(sim.pusher.force.copy())
    forces = np.array(forces)
    assert (forces[:, 0] == 0.0).all() and (forces[:3, 1, 1] == 50.0).all()
    assert forces[:, 1, 1].sum() / FPS == pytest.approx(5.0)
    assert not sim.batch.bind("xfrc_applied")[:].any()
    with pytest.raises(InputError, match="three numbers"):
        sim.pusher.push(0, np.array([0.0, np.nan, 0.0]))


@pytest.mark.parametrize("kind", OBJECTS)
def test_an_object_rests_on_the_ground_out_of_reach(kind: str) -> None:
    obj = WorldObject(kind, ahead_s=(0.0, 1.0))
    config = EnvConfig(objects=(obj,), max_error_m=99.0)
    sim = BatchSim(CLIPS, config, num_envs=6)
    sim.reset()
    start = sim.objects.pose.copy()
    away = np.linalg.norm(start[:, 0, :2] - sim.qpos[:, :2], axis=-1)
    assert (away >= CLEARANCE_M - 1e-6).all()
    assert sim.qpos.shape == (6, 47) and sim.joint_angles.shape == (6, 33)
    assert sim.observation.shape == (6, 475)
    for _ in range(8):
        sim.step(np.zeros((6, 33)))
    assert np.abs(sim.objects.pose[..., :3] - start[..., :3]).max() < 0.02


def test_objects_keep_apart_around_a_standing_avatar() -> None:
    clips = [swaying_clip("standing", frames=90)]
    objects = tuple(WorldObject(kind) for kind in OBJECTS)
    sim = BatchSim(clips, EnvConfig(objects=objects, max_error_m=99.0), num_envs=4)
    sim.reset()
    spots = sim.objects.pose[..., :2].copy()
    between = np.linalg.norm(spots[:, :, None] - spots[:, None], axis=-1)
    assert between[:, ~np.eye(len(objects), dtype=bool)].min() >= APART_M - 1e-6
    for _ in range(8):
        sim.step(np.zeros((4, 33)))
    assert np.abs(sim.objects.pose[..., :2] - spots).max() < 0.02


def test_the_avatar_is_the_same_beside_objects() -> None:
    alone = BatchSim(CLIPS, EnvConfig(fixed_start=True))
    beside = BatchSim(
        CLIPS, EnvConfig(fixed_start=True, objects=(WorldObject("box", aside_m=(3.0, 3.0)),))
    )
    for sim in (alone, beside):
        sim.reset()
        for _ in range(3):
            sim.step(NOTHING)
    np.testing.assert_allclose(beside.observation, alone.observation, atol=1e-3)
    np.testing.assert_allclose(beside.reward, alone.reward, atol=1e-5)


def test_walking_into_a_ball_kicks_it_and_info_has_the_force() -> None:
    clip = gliding_clip(2.0)
    config = EnvConfig(
        fixed_start=True, max_error_m=99.0, objects=(WorldObject("ball", (0.5, 0.5), (0.1, 0.1)),)
    )
    env = gym.make("QuestSim-v0", motions=[clip], config=config, disable_env_checker=True)
    _, info = env.reset(options={"clip": 0})
    start = info["object_pose"][0, :3].copy()
    most = 0.0
    for _ in range(30):
        *_, info = env.step(np.zeros(33, np.float32))
        most = max(most, float(np.linalg.norm(info["object_force_n"])))
    assert most > 5.0
    assert np.linalg.norm(info["object_pose"][0, :3] - start) > 0.1


def test_objects_lie_on_the_path_and_on_the_terrain() -> None:
    clips = [gliding_clip(1.5, heading=1.0)]
    obj = WorldObject("ball", (1.0, 1.0), (0.0, 0.0))
    sim = BatchSim(clips, EnvConfig(fixed_start=True, terrain=HILLS, objects=(obj,)))
    sim.reset()
    placed = sim.placed_clip(0, clips[0])
    spot = sim.objects.pose[0, 0]
    np.testing.assert_allclose(spot[:2], placed.qpos[36, :2], atol=1e-4)
    assert sim.placement.field is not None
    assert 0.0 <= spot[2] - sim.placement.field.height_at(spot) < 0.15
    travel = placed.qpos[36, :2] - placed.qpos[30, :2]
    assert rot.heading(spot[3:]) == pytest.approx(np.arctan2(travel[1], travel[0]), abs=1e-4)


def test_friction_and_mass_differ_within_a_batch_and_physics_feels_it() -> None:
    options = Randomisation(friction=(0.2, 1.0), mass=(0.8, 1.2))
    sim = BatchSim(CLIPS[:1], EnvConfig(randomisation=options), num_envs=8, seed=2)
    models = list(sim.batch.models or [])
    mass = np.array([m.body_subtreemass[1] for m in models])
    friction = np.array([m.geom("left_heel_ball_outer").friction[0] for m in models])
    assert len(np.unique(mass)) == 8 and mass.min() > 0.8 * 70 and mass.max() < 1.2 * 70.1
    assert len(np.unique(friction)) == 8 and friction.min() >= 0.2 and friction.max() <= 1.0
    for _ in range(2):
        sim.reset()
        sim.qpos[:] = sim.qpos[0]
        sim.qvel[:] = sim.qvel[0]
        for _ in range(6):
            sim.step(np.full((8, 33), 0.1))
    assert len(np.unique(sim.qpos[:, 2])) == 8
    # The bodies that other environments use are untouched.
    assert BatchSim(CLIPS[:1]).body.model.body_subtreemass[1] == pytest.approx(70.0, abs=0.1)


def test_late_devices_show_the_past() -> None:
    late = Randomisation(latency_frames=(3, 3))
    sims = [BatchSim(CLIPS, EnvConfig(fixed_start=True, randomisation=r)) for r in (late, None)]
    shown = []
    for sim in sims:
        sim.reset()
        seen = []
        for _ in range(8):
            sim.show(sim.qpos[:, :40].copy())
            seen.append(sim.observation[:, sim.layout["o_user"]].copy())
        shown.append(np.array(seen))
    np.testing.assert_array_equal(shown[0][3:], shown[1][:-3])
    assert not np.array_equal(shown[0], shown[1])


def test_a_device_in_dropout_repeats_its_last_pose_and_reports_again() -> None:
    silent = Randomisation(dropout=(0.15, 0.15), dropout_frames=(5, 5))
    sim = BatchSim(
        CLIPS[:1], EnvConfig(fixed_start=True, future_frames=0, randomisation=silent), seed=1
    )
    plain = BatchSim(CLIPS[:1], EnvConfig(fixed_start=True, future_frames=0))
    user = sim.layout["o_user"]
    frozen, seen = [], []
    for s in (sim, plain):
        s.reset()
    for _ in range(60):
        for s in (sim, plain):
            s.show(s.qpos[:, :40].copy())
        now, true = (s.observation[0, user].reshape(3, 9) for s in (sim, plain))
        frozen.append((now != true).any(axis=-1))
        seen.append(now)
    frozen, seen = np.array(frozen), np.array(seen)
    assert 0.2 < frozen.mean() < 0.8
    at, device = np.argwhere(frozen[1:] & frozen[:-1])[0]
    np.testing.assert_array_equal(seen[at + 1, device], seen[at, device])


def test_surroundings_are_restored_to_the_bit() -> None:
    config = EnvConfig(
        terrain=HILLS,
        pushes=Pushes(pause_s=(0.1, 0.4)),
        objects=(WorldObject("ball"), WorldObject("box")),
        randomisation=Randomisation((0.5, 1.0), (0.9, 1.1), (0, 4), (0.0, 0.3)),
    )

    def made(threads: int) -> QuestVecEnv:
        return QuestVecEnv(CLIPS, config, num_envs=4, seed=9, num_threads=threads)

    plan = np.random.default_rng(7).normal(0.0, 0.4, (50, 4, 33))
    env = made(1)
    env.reset()
    for action in plan[:20]:
        env.step(action)
    other = made(2)
    other.set_state(env.get_state())
    np.testing.assert_array_equal(other.reset(), env.sim.observation)
    for action in plan[20:]:
        here, there = env.step(action), other.step(action)
        np.testing.assert_array_equal(here[0], there[0])
        np.testing.assert_array_equal(here[1], there[1])
    other.close()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: WorldObject("anvil"), "unknown object 'anvil'; choose from ball"),
        (lambda: WorldObject(mass_kg=0.0), "mass_kg is 0"),
        (lambda: WorldObject(ahead_s=(2.0, 1.0)), "ahead_s is .* not a range"),
        (lambda: WorldObject(aside_m=(0.0, np.nan)), "aside_m"),
        (lambda: Pushes(force_n=(0.0, 1e6)), "force_n"),
        (lambda: Pushes(force_n=100.0), "force_n is 100.0, not a range"),  # type: ignore[arg-type]
        (lambda: Pushes(body="tail"), f"there is no link 'tail'.*{LINKS[0]}"),
        (lambda: Pushes(count=0), "count is 0"),
        (lambda: Randomisation(friction=(0.0, 1.0)), "friction"),
        (lambda: Randomisation(dropout=(0.0, 2.0)), "dropout"),
    ],
)
def test_impossible_surroundings_are_refused_in_one_line(make, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
