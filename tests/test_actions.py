"""Embedded actions: each does what its name says, and people could do it; random clips."""

import numpy as np
import pytest

from questsim import rotations as rot
from questsim.body import build_body
from questsim.errors import InputError
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import central_difference, sole_positions
from questsim.motion.spec import load_motions
from questsim.motion.synthesis.action_kinds import ACTIONS, HELD_OUT
from questsim.motion.synthesis.random_clips import TRAINED, held_out_clips, random_clips
from questsim.motion.synthesis.synthetic import KINDS, synthesise
from questsim.motion.varying import feasible
from questsim.skeleton import FOOT_LINKS, LINKS

SEEDS = (0, 1, 2)
MADE = {kind: [synthesise(kind, seed=seed, duration=7.0) for seed in SEEDS] for kind in ACTIONS}
HANDS = [LINKS.index("left_hand"), LINKS.index("right_hand")]


def feet(clip: Clip) -> np.ndarray:
    """``(T, 2, 3)`` places of the feet."""
    return clip.link_position[:, list(FOOT_LINKS)]


def fastest_hand(clip: Clip) -> float:
    """m/s, against the chest."""
    hands = clip.link_position[:, HANDS] - clip.link_position[:, [LINKS.index("chest")]]
    return float(np.linalg.norm(central_difference(hands), axis=-1).max())


@pytest.mark.parametrize("kind", ACTIONS)
def test_synthetic_actions_are_physically_possible_for_a_person(kind: str) -> None:
    limits = build_body().model.jnt_range[1:]
    # Pushing off and landing last a frame or two: there the floor's reaction is known less well.
    most = (0.25, 0.07) if kind == "jump" else (0.01, 0.02)
    for clip in MADE[kind]:
        force, moment = feasible.lacking(clip)
        assert force < most[0] and moment < most[1]
        assert np.abs(clip.qvel[:, 6:]).max() < 25.0
        assert (clip.qpos[:, 7:] >= limits[:, 0] - 1e-6).all()
        assert (clip.qpos[:, 7:] <= limits[:, 1] + 1e-6).all()
        assert not feasible.in_the_floor(clip)


@pytest.mark.parametrize("kind", ACTIONS)
def test_feet_on_the_floor_do_not_slide(kind: str) -> None:
    for clip in MADE[kind]:
        links = list(FOOT_LINKS)
        soles = sole_positions(clip.link_position[:, links], clip.link_quat[:, links], 1.75)
        # Of a sole's points that stay on the floor from one frame to the next.
        low = soles[..., 2] < 2e-3
        stays = low[1:] & low[:-1]
        moved = np.linalg.norm(np.diff(soles[..., :2], axis=0), axis=-1)
        assert moved[stays].max() < 0.012


def test_a_bow_is_deep_and_comes_up_again() -> None:
    for clip in MADE["bow"]:
        up = rot.quat_rotate(clip.link_quat[:, LINKS.index("chest")], np.array([0.0, 0.0, 1.0]))
        pitch = np.rad2deg(np.arctan2(up[:, 0], up[:, 2]))
        assert 20.0 < pitch.max() < 95.0 and abs(pitch[0]) < 8.0 and abs(pitch[-1]) < 8.0


def test_a_hand_picks_up_from_near_the_floor() -> None:
    for clip in MADE["pick-up"]:
        assert clip.link_position[:, HANDS, 2].min() < 0.32


def test_a_lunge_is_a_long_step_and_a_low_pelvis() -> None:
    for clip in MADE["lunge"]:
        apart = np.linalg.norm(np.diff(feet(clip)[..., :2], axis=1), axis=-1)
        low = clip.qpos[:, 2].argmin()
        assert apart[low] > 0.45 and clip.qpos[0, 2] - clip.qpos[low, 2] > 0.12


def test_a_kick_lifts_one_foot_over_the_other() -> None:
    for clip in MADE["kick"]:
        height = feet(clip)[..., 2]
        top = height.max(axis=1).argmax()
        assert height[top].max() > 0.25 and height[top].min() < 0.1


def test_a_jump_flies_as_bodies_fall() -> None:
    for clip in MADE["jump"]:
        soles = feet(clip)[..., 2].min(axis=1)
        flies = soles > 0.13
        assert flies.sum() >= 2
        fall = np.gradient(np.gradient(clip.qpos[:, 2], 1 / FPS), 1 / FPS)
        top = soles.argmax()
        assert fall[top] == pytest.approx(-9.81, abs=0.5)
        assert np.abs(clip.qpos[:, :2]).max() < 0.25


def test_ducks_lower_the_head_quickly() -> None:
    head = LINKS.index("head")
    for clip in MADE["duck"]:
        height = clip.link_position[:, head, 2]
        span = int(0.6 * FPS)
        assert (height[:-span] - height[span:]).max() > 0.06


def test_punches_swings_and_throws_are_fast() -> None:
    for kind in ("punch", "swing", "throw"):
        assert all(fastest_hand(clip) > 2.0 for clip in MADE[kind])


def test_a_guide_shows_away_from_the_body() -> None:
    for clip in MADE["guide"]:
        chest = clip.link_position[:, [LINKS.index("chest")]]
        away = np.linalg.norm((clip.link_position[:, HANDS] - chest)[..., :2], axis=-1)
        assert away.max() > 0.5


@pytest.mark.parametrize(("kind", "axis"), [("shuffle", 1), ("cross-step", 1), ("step-touch", 1)])
def test_side_steps_travel_sidewards(kind: str, axis: int) -> None:
    for clip in MADE[kind]:
        assert np.ptp(clip.qpos[:, axis]) > 0.15
        assert np.ptp(clip.qpos[:, 0]) < 0.2


def test_feet_cross_in_cross_steps_alone() -> None:
    def crosses(clip: Clip) -> bool:
        left, right = feet(clip)[:, 0, 1], feet(clip)[:, 1, 1]
        return bool((right > left + 0.05).any())

    assert all(crosses(clip) for clip in MADE["cross-step"])
    assert not any(crosses(clip) for clip in MADE["shuffle"])


def test_steps_back_go_back_and_crouched_walks_forward_and_low() -> None:
    for clip in MADE["step-back"]:
        assert clip.qpos[:, 0].min() < -0.15
    for clip in MADE["crouch-walk"]:
        assert clip.qpos[-1, 0] > 0.5 and clip.qpos[0, 2] - clip.qpos[:, 2].min() > 0.08


def test_random_clips_do_not_depend_on_how_many_there_are() -> None:
    some, more = random_clips(3, seed=5), random_clips(4, seed=5)
    for a, b in zip(some, more, strict=False):
        assert a.name == b.name and np.array_equal(a.qpos, b.qpos)
    assert not np.array_equal(some[0].qpos, random_clips(1, seed=6)[0].qpos)
    assert {clip.licence for clip in more} == {"MIT"}


def test_random_clips_have_all_kinds_that_are_not_held_out() -> None:
    assert set(TRAINED) == set(KINDS) | set(ACTIONS) - set(HELD_OUT)
    clips = random_clips(len(TRAINED), seed=1)
    assert [clip.kind for clip in clips] == list(TRAINED)
    assert {clip.kind for clip in held_out_clips(4)} == set(HELD_OUT)


def test_a_motion_argument_names_actions_and_random_clips() -> None:
    assert [clip.kind for clip in load_motions("synthetic:bow")] == ["bow"] * 4
    assert len(load_motions("synthetic:random:3")) == 3
    held = load_motions("synthetic:held-out:4", seed=3)
    assert {clip.kind for clip in held} == set(HELD_OUT)
    some = load_motions("synthetic:bow+shuffle:5", seed=3)
    assert [clip.kind for clip in some] == ["bow", "shuffle", "bow", "shuffle", "bow"]
    assert np.array_equal(some[1].qpos, random_clips(2, 3, ("bow", "shuffle"))[1].qpos)
    seats = load_motions("synthetic:sit:6", seed=7)
    assert len({clip.name for clip in seats}) == 6 and seats[0].name == "synthetic-sit-1-7"
    assert np.array_equal(seats[5].qpos, load_motions("synthetic:sit", seed=8)[1].qpos)
    everything = load_motions("synthetic:all")
    assert len(everything) == 54 + 4 * len(ACTIONS)
    assert [c.name for c in everything[:54]] == [c.name for c in load_motions("synthetic")]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("synthetic:random:0", r"synthetic:random:0: '0' is not a number of clips"),
        ("synthetic:random:" + "3" * 5000, "' is not a number of clips"),
        ("synthetic:random:-3", "'-3' is not a number of clips"),
        ("synthetic:held-out:many", "'many' is not a number of clips"),
        ("synthetic:bow:0", "'0' is not a number of clips"),
        ("synthetic:bow+hover:5", "there is no kind 'hover'"),
        ("synthetic:bow+sit:5", "some kinds need a chair, and some do not; write two parts"),
        ("synthetic:hover", "there is no kind 'hover'; choose from stand, walk.*bow.*all"),
    ],
)
def test_motion_arguments_that_cannot_be_are_refused(spec: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_motions(spec)


def test_an_action_too_short_to_be_done_and_a_seated_random_clip_are_refused() -> None:
    with pytest.raises(InputError, match="duration 2 s is outside 4-60 s"):
        synthesise("kick", duration=2.0)
    with pytest.raises(InputError, match="bow has no speed"):
        synthesise("bow", speed=1.0)
    with pytest.raises(InputError, match="'sit' needs a chair"):
        random_clips(1, kinds=("sit",))
