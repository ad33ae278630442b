"""The ground: its shapes, how it collides, and what environments make of it."""

from __future__ import annotations

import warnings
from dataclasses import replace

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gym_check_env
from helpers import swaying_clip, two_columns
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from envs import BatchSim, EnvConfig, QuestVecEnv, Terrain, terrain_named
from envs.layout import SCAN_POINTS
from envs.placement import moved, turn_quat
from envs.registration import ENVIRONMENTS
from envs.terrain import TERRAINS, height_field, tile_centre
from questsim import reward
from questsim import rotations as rot
from questsim.body import build_body, scaled_spec
from questsim.errors import InputError
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.spec import load_motions

CLIPS = [swaying_clip("a", 1.75), swaying_clip("b", 1.6, frames=50)]
HILLS = Terrain("waves", amplitude_m=0.2, wavelength_m=3.0, size_m=16.0)

STANDING = load_motions("synthetic:stand")[0]


def gliding_clip(speed: float = 1.2, heading: float = 0.0, frames: int = 72) -> Clip:
    """The swaying person, carried along."""
    qpos = swaying_clip(frames=frames).qpos.copy()
    along = speed * np.arange(frames) / FPS
    qpos[:, 0], qpos[:, 1] = along * np.cos(heading), along * np.sin(heading)
    qpos[:, 3:7] = rot.yaw_quat(np.full(frames, heading))
    return clip_from_qpos(f"glide-{heading:g}", qpos, 1.75, kind="walk", licence="MIT")


@pytest.mark.parametrize("name", TERRAINS)
def test_the_surface_looked_up_is_the_one_that_collides(name: str) -> None:
    field = height_field(replace(TERRAINS[name], size_m=16.0, tile_m=4.0))
    spec = scaled_spec(1.75)
    field.replace_floor(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    only_floor, hit = np.array([1, 0, 0, 0, 0, 0], np.uint8), np.zeros(1, np.int32)
    points = np.random.default_rng(0).uniform(-7.0, 7.0, (100, 2))
    for point in points:
        start = np.array([*point, 20.0])
        distance = mujoco.mj_ray(
            model, data, start, np.array([0.0, 0.0, -1.0]), only_floor, 1, -1, hit
        )
        assert 20.0 - distance == pytest.approx(field.height_at(point), abs=1e-5)


def test_each_shape_has_the_size_it_was_asked_for() -> None:
    rough = height_field(Terrain("rough", amplitude_m=0.08)).height
    assert 0.079 < rough.max() <= 0.08 and -0.08 <= rough.min() < -0.079
    assert rough.std() == pytest.approx(0.08 / np.sqrt(3.0), rel=0.05)  # of even numbers
    waves = height_field(TERRAINS["waves"]).height
    assert 0.09 < waves.max() <= 0.1
    slope = height_field(Terrain("slope", slope_deg=10.0))
    rise = slope.height_at(np.array([4.0, 2.0])) - slope.height_at(np.array([1.0, -3.0]))
    assert rise == pytest.approx(3.0 * np.tan(np.deg2rad(10.0)), abs=1e-5)
    stairs = height_field(TERRAINS["stairs"]).height[0]
    risers = np.abs(np.diff(stairs))
    np.testing.assert_allclose(risers[risers > 1e-6], 0.08, atol=1e-6)
    gaps = height_field(Terrain("gaps", gap_m=0.3, gap_depth_m=0.5)).height[0]
    assert set(np.round(gaps, 6)) == {0.0, -0.5}


def test_difficulty_scales_a_terrain() -> None:
    half = height_field(Terrain("rough", difficulty=0.5)).height
    np.testing.assert_allclose(half, 0.5 * height_field(Terrain("rough")).height, atol=1e-7)


def test_same_seed_same_ground_and_another_seed_another() -> None:
    height_field.cache_clear()
    first = height_field(TERRAINS["course"]).height
    height_field.cache_clear()
    np.testing.assert_array_equal(height_field(TERRAINS["course"]).height, first)
    other = height_field(replace(TERRAINS["course"], seed=1)).height
    assert not np.array_equal(other, first)


def test_a_course_has_a_tile_of_each_kind_that_grows_harder() -> None:
    terrain = Terrain("course", tiles=("rough", "stairs", "gaps"), levels=3)
    field = height_field(terrain)
    reach = np.linspace(-3.0, 3.0, 61)
    around = np.stack(np.meshgrid(reach, reach), -1)

    def relief(column: int, level: int) -> float:
        return float(
            np.ptp(
                field.height_at(around + tile_centre(terrain, np.array(column), np.array(level)))
            )
        )

    for column, most in enumerate((0.08, 0.4, 0.3)):
        reliefs = [relief(column, level) for level in range(3)]
        assert reliefs == sorted(reliefs) and reliefs[0] > 0.01
        assert reliefs[2] == pytest.approx(most, rel=0.1)
    seam = field.height_at(tile_centre(terrain, np.array([0.5, 1.5]), np.array([1.0, 0.0])))
    np.testing.assert_allclose(seam, 0.0, atol=1e-6)


def test_the_ground_below_an_avatar_leaves_out_gaps() -> None:
    field = height_field(TERRAINS["gaps"])
    assert field.height.min() < -0.2 and np.abs(field.ground).max() == 0.0


def test_a_flat_terrain_is_a_plane() -> None:
    """Where S turns and moves with the avatar, nothing depends on the place."""
    config = EnvConfig(fixed_start=True, privileged=True)
    plane = BatchSim(CLIPS, config)
    field = BatchSim(CLIPS, replace(config, terrain=Terrain("flat", direction="up")))
    for sim in (plane, field):
        sim.reset()
    np.testing.assert_allclose(field.observation, plane.observation, atol=1e-4)
    for _ in range(5):
        for sim in (plane, field):
            sim.step(np.zeros((2, 33)))
        for block, tolerance in (("link_positions", 5e-3), ("o_user", 5e-3), ("privileged", 0.1)):
            part = plane.layout[block]
            np.testing.assert_allclose(
                field.observation[:, part], plane.observation[:, part], atol=tolerance
            )
        # Planes and height fields take contacts at slightly different points.
        np.testing.assert_allclose(field.contact_force, plane.contact_force, atol=25.0)
        np.testing.assert_allclose(field.error, plane.error, atol=2e-3)
    assert (field.contact_force[..., 2] > 50.0).any(axis=-1).all()


def test_frame_s_stands_on_the_ground_and_devices_on_the_users_floor() -> None:
    flat = BatchSim(CLIPS, EnvConfig(fixed_start=True))
    hills = BatchSim(CLIPS, EnvConfig(fixed_start=True, terrain=HILLS))
    flat.reset()
    hills.reset()
    assert hills.placement.field is not None
    np.testing.assert_allclose(hills.floor, hills.placement.field.ground_at(hills.qpos[:, :2]))
    assert np.abs(hills.floor).min() > 0.01
    user = flat.layout["o_user"]
    np.testing.assert_allclose(hills.observation[:, user], flat.observation[:, user], atol=1e-5)
    positions = hills.observation[:, hills.layout["link_positions"]].reshape(2, 16, 3)
    expected = hills.link_positions[..., 2] - hills.floor[:, None]
    np.testing.assert_allclose(positions[..., 2], expected, atol=1e-6)


@pytest.mark.parametrize("heights", [None, (1.5, 1.9)])
def test_error_and_reward_are_against_the_placed_and_lifted_clip(heights) -> None:
    clips = [gliding_clip(heading=0.5), gliding_clip(0.7)]
    terrain = replace(HILLS, size_m=24.0)
    config = EnvConfig(fixed_start=True, terrain=terrain, heights=heights)
    sim = BatchSim(clips, config, seed=4)
    sim.reset()
    for _ in range(4):
        sim.step(np.zeros((2, 33)))
    for i, clip in enumerate(clips):
        placed = sim.placed_clip(i, clip)
        row = sim.frame[i] - sim.reference.start[i]
        error = np.linalg.norm(sim.link_positions[i] - placed.link_position[row], axis=-1).mean()
        assert sim.error[i] == pytest.approx(error, abs=1e-5)
        model, data, velocity = (
            build_body(float(sim.heights[i])).model,
            sim.batch.get_data(i),
            np.zeros((16, 6)),
        )
        for b in range(16):
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectVelocity(model, data, kind, b + 1, velocity[b], 0)
        term = reward.link_tracking(
            velocity[None, :, 3:],
            placed.link_velocity[row][None],
            config.reward.k_link_velocities,
        )
        assert sim.reward_terms[i, 3] == pytest.approx(term[0], abs=1e-4)


def seen_links(sim: BatchSim) -> tuple[np.ndarray, np.ndarray]:
    """Places in S and columns that a teacher sees of the links in the next frame."""
    seen = sim.observation[0, sim.layout["privileged"]][66:]
    return seen[:48].reshape(16, 3), seen[48:144].reshape(16, 6)


@pytest.mark.parametrize("clip", [gliding_clip(heading=-1.0), STANDING], ids=["moves", "stands"])
def test_a_teacher_observes_the_lifted_reference_and_feet_on_the_ground_while_standing(
    clip,
) -> None:
    sim = BatchSim([clip], EnvConfig(fixed_start=True, terrain=HILLS, privileged=True))
    sim.reset()
    footed = sim.placed_clip(0, clip)
    field, place = sim.placement.field, sim.placement.place[0]
    assert field is not None
    position = moved(place[None], clip.link_position[1])
    position[:, 2] += field.ground_at(position[:1, :2])
    wanted = footed.link_position[1] if clip is STANDING else position
    assert np.abs(footed.link_position[1] - position).max() > 0.01
    to_s = rot.quat_conjugate(rot.yaw_quat(rot.heading(sim.qpos[0, 3:7])))
    places, columns = seen_links(sim)
    offset = rot.quat_rotate(to_s, wanted - sim.link_positions[0])
    np.testing.assert_allclose(places, offset, atol=1e-4)
    turned = rot.quat_multiply(turn_quat(place[None]), clip.link_quat[1])
    turned = footed.link_quat[1] if clip is STANDING else turned
    np.testing.assert_allclose(columns, two_columns(rot.quat_multiply(to_s, turned)), atol=1e-4)


def test_an_episode_begins_with_no_sole_in_the_ground() -> None:
    sim = BatchSim(CLIPS, EnvConfig(terrain=Terrain("rough", amplitude_m=0.08)), num_envs=20)
    sim.reset()
    clearance = sim.foot_clearance.min(axis=-1)
    assert clearance.min() > -1e-6 and clearance.max() < 0.15


@pytest.mark.parametrize(
    ("direction", "wanted"), [("up", (1, 0)), ("down", (-1, 0)), ("across", (0, 1))]
)
def test_clips_travel_in_the_direction_asked_for(direction: str, wanted: tuple) -> None:
    clips = [gliding_clip(heading=heading) for heading in (0.0, 2.0, -1.0)]
    sim = BatchSim(
        clips, EnvConfig(fixed_start=True, terrain=Terrain("slope", direction=direction))
    )
    sim.reset()
    for i, clip in enumerate(clips):
        path = sim.placed_clip(i, clip).link_position[:, 0]
        travel = (path[-1] - path[0])[:2]
        np.testing.assert_allclose(travel / np.linalg.norm(travel), wanted, atol=1e-6)
        rise = {"up": 1.0, "down": -1.0, "across": 0.0}[direction]
        rise *= np.tan(np.deg2rad(8.0)) * np.linalg.norm(travel)
        assert path[-1, 2] - path[0, 2] == pytest.approx(rise, abs=1e-4)


def test_paths_stay_on_the_ground_and_those_that_cannot_are_refused() -> None:
    terrain = Terrain("rough", size_m=10.0)
    clip = gliding_clip(3.0)  # 6 m
    sim = BatchSim([clip], EnvConfig(terrain=terrain), num_envs=30)
    sim.reset()
    assert sim.placement.field is not None
    half = 0.5 * np.array(sim.placement.field.size) - 1.0
    for i in range(30):
        path = sim.placed_clip(i, clip).link_position[:, 0, :2]
        assert (np.abs(path) <= half).all()
    with pytest.raises(InputError, match=r"glide.*11\.8 m wide.*size_m"):
        BatchSim([gliding_clip(6.0)], EnvConfig(terrain=terrain))


def test_places_are_drawn_anew_for_episodes_and_fixed_for_evaluation() -> None:
    drawn = BatchSim(CLIPS, EnvConfig(terrain=HILLS), num_envs=4)
    fixed = BatchSim(CLIPS, EnvConfig(terrain=HILLS, fixed_start=True))
    places = []
    for sim in (drawn, fixed):
        for _ in range(2):
            sim.reset()
            places.append(sim.placement.place.copy())
    assert len(np.unique(places[0][:, 0])) == 4
    assert not np.array_equal(places[0], places[1])
    np.testing.assert_array_equal(places[2], places[3])
    alone = BatchSim(CLIPS[1:], EnvConfig(terrain=HILLS, fixed_start=True))
    alone.reset()
    np.testing.assert_array_equal(alone.placement.place[0], places[2][1])


def test_a_terrain_does_not_change_which_clips_are_drawn() -> None:
    flat = BatchSim(CLIPS, num_envs=6, seed=3)
    hills = BatchSim(CLIPS, EnvConfig(terrain=HILLS), num_envs=6, seed=3)
    for _ in range(3):
        flat.reset()
        hills.reset()
        np.testing.assert_array_equal(flat.frame, hills.frame)


def rollout(threads: int) -> list[np.ndarray]:
    config = EnvConfig(terrain=TERRAINS["course"], height_scan=True)
    env = QuestVecEnv(CLIPS, config, num_envs=5, seed=5, num_threads=threads)
    collected = [env.reset()]
    plan = np.random.default_rng(7).normal(0.0, 0.3, (40, 5, 33))
    collected += [env.step(action)[0] for action in plan]
    env.close()
    return collected


def test_same_seed_same_bits_at_one_and_two_threads_on_a_course() -> None:
    np.testing.assert_array_equal(rollout(1), rollout(2))


def test_a_restored_environment_goes_on_at_its_places_to_the_bit() -> None:
    def made(seed: int) -> QuestVecEnv:
        return QuestVecEnv(CLIPS, EnvConfig(terrain=HILLS), num_envs=3, seed=seed)

    env, plan = made(9), np.random.default_rng(7).normal(0.0, 0.5, (60, 3, 33))
    env.reset()
    for action in plan[:20]:
        env.step(action)
    other = made(1)
    other.set_state(env.get_state())
    np.testing.assert_array_equal(other.reset(), env.sim.observation)
    for action in plan[20:]:
        np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])


def test_the_height_scan_is_the_surface_around_the_avatar() -> None:
    terrain = replace(TERRAINS["steps"], size_m=16.0)
    sim = BatchSim(CLIPS, EnvConfig(terrain=terrain, height_scan=True, fixed_start=True))
    sim.reset()
    assert sim.observation.shape[1] == 475 + len(SCAN_POINTS)
    assert sim.placement.field is not None
    for i in range(2):
        turn = rot.heading(sim.qpos[i, 3:7])
        matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        points = sim.qpos[i, :2] + SCAN_POINTS @ matrix.T
        expected = sim.placement.field.height_at(points) - sim.floor[i]
        np.testing.assert_allclose(
            sim.observation[i, sim.layout["height_scan"]], expected, atol=1e-5
        )
    plane = BatchSim(CLIPS, EnvConfig(height_scan=True, fixed_start=True))
    plane.reset()
    assert (plane.observation[:, plane.layout["height_scan"]] == 0.0).all()


def test_feet_feel_the_ground() -> None:
    sim = BatchSim(CLIPS[:1], EnvConfig(terrain=TERRAINS["slope"], privileged=True))
    sim.reset()
    gain = 4.0 * sim.body.damping / 0.04 / sim.body.torque_limits
    columns = sim.layout["reference_joint_angles"]
    upward = []
    for _ in range(12):
        sim.step(gain * (sim.observation[:, columns] - sim.observation[:, :33]))
        upward.append(sim.contact_force[0, :, 2].sum())
    weight = 9.81 * sim.body.model.body_mass.sum()
    assert np.mean(upward[4:]) == pytest.approx(weight, rel=0.35)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "lava"}, "unknown kind 'lava'"),
        ({"amplitude_m": -0.1}, "amplitude_m is -0.1, not 0 to 0.5"),
        ({"amplitude_m": float("nan")}, "amplitude_m is nan"),
        ({"slope_deg": 60.0}, "slope_deg is 60"),
        ({"gap_m": 2.0}, "gap_m is 2"),
        ({"difficulty": 1.5}, "difficulty is 1.5"),
        ({"direction": "left"}, "unknown direction"),
        ({"tiles": ("rough", "course")}, "unknown tile 'course'"),
        ({"tiles": ()}, "has no tiles"),
        ({"levels": 2.5}, "not a whole number"),
        ({"seed": "x"}, "seed is 'x'"),
    ],
)
def test_impossible_terrains_are_refused_in_one_line(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        Terrain(**options)
    assert "\n" not in str(caught.value)


def test_a_terrain_is_read_from_its_name_and_options() -> None:
    assert terrain_named("rough") == Terrain("rough")
    changed = terrain_named("stairs:step_height_m=0.12,seed=3,direction=down")
    assert changed == replace(TERRAINS["stairs"], step_height_m=0.12, seed=3, direction="down")
    for text, message in (
        ("lava", "unknown terrain"),
        ("rough:depth=1", "not an option of a terrain"),
        ("rough:seed", "not an option"),
        ("rough:seed=a", "'a' is not of type int"),
        ("rough:amplitude_m=9", "amplitude_m is 9"),
        (
            "slope:amplitude_m=0.1",
            "'amplitude_m=0.1' has no effect on the terrain slope; it reads slope",
        ),
        ("flat:seed=3", "'seed=3' has no effect on the terrain flat"),
        ("mixed:amplitude_m=0.1", "'amplitude_m=0.1' has no effect on the terrain mixed"),
    ):
        with pytest.raises(InputError, match=message):
            terrain_named(text)


@pytest.mark.parametrize("name", [name for name in ENVIRONMENTS if "terrain" in ENVIRONMENTS[name]])
def test_both_libraries_accept_each_terrain(name: str) -> None:
    env = gym.make(name, motions=CLIPS)
    assert env.observation_space.shape == (475,)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gym_check_env(env.unwrapped, skip_render_check=True)
        sb3_check_env(env.unwrapped)
    env.close()
    vector = gym.make_vec(name, num_envs=3, motions=CLIPS)
    vector.reset(seed=1)
    _, _, _, _, infos = vector.step(np.zeros((3, 33), np.float32))
    assert infos["floor_m"].shape == (3,)
    vector.close()
