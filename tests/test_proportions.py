"""Bodies of other proportions: their shape, the clips on them, and the error of retargeting."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from envs.config import EnvConfig
from envs.core import BatchSim
from envs.terrain import TERRAINS
from questsim.body import build_body
from questsim.body_proportions import PARTS, Proportions, drawn_proportions
from questsim.errors import InputError
from questsim.motion.kinematics import link_poses, sole_positions
from questsim.motion.library import load_library, save_library
from questsim.motion.own_body import own_body
from questsim.motion.reproportion import with_proportions
from questsim.motion.retarget import retargeting_error, to_clip
from questsim.motion.retarget_back import to_motion
from questsim.motion.synthesis.synthetic import synthesise
from questsim.proportions import BONES, resized
from questsim.skeleton import FOOT_LINKS, LINKS

LONG_ARMS = Proportions.of_parts(arms=1.2, legs=0.9, trunk=1.1, shoulders=1.15, hips=0.85)
UPPER = ("shoulder", "elbow", "wrist", "spine1", "spine2", "neck")
WALK = synthesise("walk", duration=3.0, seed=2)


def place(model: mujoco.MjModel, name: str) -> np.ndarray:
    return model.body(name).pos


def test_parts_multiply_the_lengths_of_the_body_and_nothing_else() -> None:
    here, there = build_body(1.6, proportions=LONG_ARMS).model, build_body(1.6).model
    for name, factor in (
        ("left_forearm", 1.2), ("right_hand", 1.2), ("left_shin", 0.9), ("right_foot", 0.9),
        ("spine", 1.1), ("chest", 1.1), ("head", 1.1),
    ):  # fmt: skip
        np.testing.assert_allclose(place(here, name), factor * place(there, name), atol=1e-6)
    np.testing.assert_allclose(
        place(here, "left_upper_arm"), place(there, "left_upper_arm") * [1, 1.15, 1.1], atol=1e-6
    )
    assert place(here, "left_thigh")[1] == pytest.approx(0.85 * place(there, "left_thigh")[1])
    # A forearm that is 1.2 times as long has 1.2 times the mass, and its capsule ends further out.
    forearm = here.body("left_forearm").id
    assert here.body_mass[forearm] == pytest.approx(1.2 * there.body_mass[forearm])
    np.testing.assert_allclose(here.body_ipos[forearm], 1.2 * there.body_ipos[forearm], atol=1e-9)
    geom = here.geom("left_forearm").id
    assert here.geom_size[geom, 0] == there.geom_size[geom, 0]
    for name in ("head", "left_foot", "right_hand"):
        link = here.body(name).id
        assert here.body_mass[link] == there.body_mass[link]
    assert here.body_inertia[1:].min() > 0.0
    assert LONG_ARMS.parts() == pytest.approx(
        dict(zip(PARTS, (1.2, 0.9, 1.1, 1.15, 0.85), strict=True))
    )


def test_inertia_of_a_stretched_link_is_that_of_the_stretched_solid() -> None:
    # A thin rod's transverse inertia grows with the cube of its length; here it is nearly a rod.
    here = build_body(proportions=Proportions.of_parts(arms=1.5)).model
    link, there = here.body("left_forearm").id, build_body().model
    long, short = here.body_inertia[link], there.body_inertia[link]
    about = short.min()  # about its own axis: only the mass grows
    assert long.min() == pytest.approx(1.5 * about, rel=1e-6)
    across = (short.max() - about / 2.0) * 1.5**3 + 1.5 * about / 2.0
    assert long.max() == pytest.approx(across, rel=1e-6)


def test_kinematics_agree_with_the_model_of_those_proportions() -> None:
    clip = with_proportions(WALK, LONG_ARMS)
    model = build_body(clip.height_m, proportions=LONG_ARMS).model
    data = mujoco.MjData(model)
    for frame in (0, 40):
        data.qpos[:] = clip.qpos[frame]
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(clip.link_position[frame], data.xpos[1:], atol=1e-6)
    again, _ = link_poses(clip.scaled(1.5).qpos, 1.5, proportions=clip.proportions)
    np.testing.assert_allclose(clip.scaled(1.5).link_position, again, atol=1e-6)


def test_a_clip_on_other_proportions_is_drawn_as_often() -> None:
    heavy = replace(WALK, weight=3.0)
    assert with_proportions(heavy, LONG_ARMS).weight == 3.0
    sim = BatchSim([heavy, WALK], EnvConfig(proportions=0.05), 2)
    assert sim.reference.weights.tolist() == [3.0, 1.0]


def test_a_clip_on_other_proportions_keeps_its_feet_on_the_floor_and_does_not_skate() -> None:
    clip = with_proportions(WALK, LONG_ARMS)

    def soles(c):
        feet = list(FOOT_LINKS)
        return sole_positions(c.link_position[:, feet], c.link_quat[:, feet], c.height_m)

    def skating(c) -> float:
        lowest = soles(c).mean(axis=2)
        speed = np.linalg.norm(np.diff(lowest[..., :2], axis=0), axis=-1) * 36.0
        return float(speed[c.contacts[1:] & c.contacts[:-1]].mean())

    assert soles(clip)[..., 2].min() > -0.002
    assert (clip.contacts == WALK.contacts).mean() > 0.95
    assert skating(clip) < 1.3 * skating(WALK) + 0.01
    np.testing.assert_array_equal(clip.qpos[:, 19:], WALK.qpos[:, 19:])  # trunk, head, arms
    back = with_proportions(clip, None)
    assert back.proportions is None
    assert abs(back.link_position - WALK.link_position).max() < 0.02


def test_own_proportions_take_away_the_error_of_the_upper_body() -> None:
    bones = {"shoulder width": 0.75, "left upper arm": 0.8, "right upper arm": 0.8}
    bones |= {"lower trunk": 0.85, "upper trunk": 0.85, "neck": 0.9, "left forearm": 0.95}
    person = resized(to_motion(WALK), np.array([bones.get(name, 1.0) for name, _ in BONES]))

    def upper(own: bool) -> float:
        error = retargeting_error(person, to_clip(person, own_proportions=own))
        return float(np.mean([e for joint, e in error.items() if joint.endswith(UPPER)]))

    assert upper(own=False) > 3.0
    assert upper(own=True) < 1.0
    clip = to_clip(person, own_proportions=True)
    assert clip.proportions is not None
    assert clip.proportions == own_body(person, clip.height_m)
    # And back: the clip's motion has the bones of the person.
    again = own_body(to_motion(clip), clip.height_m)
    np.testing.assert_allclose(again.array(), clip.proportions.array(), atol=2e-3)


def test_a_library_keeps_the_proportions_of_its_clips(tmp_path) -> None:
    clips = [WALK, with_proportions(WALK, LONG_ARMS)]
    save_library(tmp_path / "a.npz", [], clips)
    plain, other = load_library(tmp_path / "a.npz").clips
    assert plain.proportions is None and other.proportions == LONG_ARMS
    np.testing.assert_allclose(other.link_position, clips[1].link_position, atol=1e-5)
    save_library(tmp_path / "b.npz", [], clips[:1])
    with np.load(tmp_path / "b.npz") as archive:
        assert "clip_places" not in archive.files


def test_impossible_proportions_are_refused() -> None:
    with pytest.raises(InputError, match=r"arms are 2 times the default body's, not 0.6 to 1.6"):
        Proportions.of_parts(arms=2.0)
    with pytest.raises(InputError, match="16 triples"):
        Proportions(((0.0, 0.0, 0.0),))


def test_drawn_proportions_differ_by_the_spread_and_repeat() -> None:
    drawn = drawn_proportions(0.06, 200, seed=3)
    logs = np.log([list(p.parts().values()) for p in drawn])
    assert drawn == drawn_proportions(0.06, 200, seed=3)
    assert drawn[:5] == drawn_proportions(0.06, 5, seed=3)
    np.testing.assert_allclose(logs.std(axis=0), 0.06, rtol=0.2)
    assert abs(np.corrcoef(logs.T) - np.eye(5)).max() < 0.25
    assert len(LINKS) == 16


def test_simulations_play_the_clips_of_their_own_bodies() -> None:
    stand = synthesise("stand", duration=3.0, seed=1)
    clips = [WALK, with_proportions(stand, LONG_ARMS), with_proportions(WALK, LONG_ARMS)]
    sim = BatchSim(clips, EnvConfig(observe_proportions=True), 5, seed=4)
    played = set()
    for _ in range(12):
        sim.reset()
        for i, clip in enumerate(sim.clip):
            assert sim.bodies.proportions[i] == clips[clip].proportions
            played.add(int(clip))
    assert played == {0, 1, 2}
    seen = sim.observation[:, sim.layout["o_scale"]]
    np.testing.assert_allclose(seen[0], [WALK.height_m, 1, 1, 1, 1, 1], atol=1e-6)
    np.testing.assert_allclose(seen[1, 1:], list(LONG_ARMS.parts().values()), atol=1e-6)
    # The body of simulation 1 stands in the pose of its reference.
    sim.reset(np.array([1]), clip=2, frame=10)
    np.testing.assert_allclose(
        sim.link_positions[1],
        clips[2].link_position[10] * sim.heights[1] / WALK.height_m,
        atol=2e-3,
    )
    with pytest.raises(InputError, match="for other proportions than those of simulation 0"):
        sim.reset(np.array([0]), clip=2)
    with pytest.raises(InputError, match="2 bodies of different proportions, which 1 simulations"):
        BatchSim(clips, EnvConfig(), 1)


def test_drawn_proportions_of_a_batch_differ_between_simulations_and_move_the_reference() -> None:
    config = EnvConfig(proportions=0.08)
    sim = BatchSim([WALK] * 4, config, 4, seed=2)
    assert len(set(sim.bodies.proportions)) == 4 and None not in sim.bodies.proportions
    sim.reset()
    assert sim.layout["o_scale"].stop - sim.layout["o_scale"].start == 1
    for i in range(4):
        frame = int(sim.frame[i] - sim.reference.start[sim.clip[i]])
        placed = sim.placed_clip(i, WALK)
        np.testing.assert_allclose(placed.link_position[frame], sim.link_positions[i], atol=2e-3)
        hand = LINKS.index("left_hand")
        arm = np.linalg.norm(sim.link_positions[i, hand] - sim.link_positions[i, hand - 1])
        body = sim.bodies.proportions[i]
        assert body is not None
        assert arm == pytest.approx(0.2555 * body.parts()["arms"] * sim.heights[i] / 1.75, rel=1e-3)
    with pytest.raises(InputError, match="proportions: does not go with a terrain"):
        EnvConfig(proportions=0.1, terrain=TERRAINS["rough"])
    with pytest.raises(InputError, match=r"proportions is 0.5, not 0 to 0.15"):
        EnvConfig(proportions=0.5)
