"""Variations: parts put together again, feet that stay, balance, what people cannot do."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from questsim import rotations as rot
from questsim.body import build_body
from questsim.body_proportions import Proportions
from questsim.cli import main
from questsim.errors import InputError
from questsim.licences import of_parts
from questsim.motion.clip import FPS, Clip, source_kind
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.library import load_library
from questsim.motion.spec import load_motions
from questsim.motion.variation import Recipe, Tally, draw, vary
from questsim.motion.varying import feasible, stances, upper
from questsim.motion.varying.figure import default_poses, figure_of, in_other_time, solve
from questsim.skeleton import DOFS, FOOT_LINKS

CLIPS = load_motions("synthetic:walk+stand+wave+jog+side-left")
WALK = next(clip for clip in CLIPS if clip.name == "synthetic-walk-1.2-start-stop")
STAND = next(clip for clip in CLIPS if clip.kind == "stand")
JOG = next(clip for clip in CLIPS if clip.name == "synthetic-jog-2.6")
SOME = [WALK, STAND, *[clip for clip in CLIPS if clip.kind in ("wave", "side-left")]]


def figure_and_clip(clip: Clip, change=lambda figure: None) -> tuple[Clip, Clip]:
    """A clip as it was and after a change of its figure."""
    figure = figure_of(default_poses(clip))
    change(figure)
    return clip, clip_from_qpos("changed", solve(figure), clip.height_m)


def foot_speed(clip: Clip, foot: int, first: int, last: int) -> float:
    """Greatest speed of a foot's origin over the floor between two frames, m/s."""
    velocity = clip.link_velocity[first : last + 1, FOOT_LINKS[foot], :2]
    return float(np.linalg.norm(velocity, axis=-1).max())


def test_a_clip_taken_apart_and_put_together_is_the_same() -> None:
    for clip in (WALK, JOG, STAND):
        before, after = figure_and_clip(clip)
        assert np.abs(before.qpos[:, :3] - after.qpos[:, :3]).max() < 1e-3
        assert np.abs(before.link_position - after.link_position).max() < 3e-3


def test_the_same_seed_gives_the_same_bits_however_many_are_asked_for() -> None:
    one, more = vary(SOME, 2, seed=7), vary(SOME, 3, seed=7)
    for a, b in zip(one, more, strict=False):
        assert a.name == b.name and np.array_equal(a.qpos, b.qpos)
    other = vary(SOME, 1, seed=8)[0]
    assert other.source != one[0].source


def test_variations_say_what_they_are_made_of() -> None:
    for clip in vary(SOME, 6, seed=1):
        base = clip.name.split("-vary-")[0]
        assert clip.source.startswith(f"variation of {base}")
        assert "speed " in clip.source and clip.licence == "MIT"
        assert clip.kind.split("+")[0] in {c.kind for c in SOME}


def test_speed_and_reversal_change_time_alone() -> None:
    poses = default_poses(WALK)
    fast = in_other_time(poses, 1.25, reverse=False)
    assert len(fast) == int((len(poses) - 1) / 1.25) + 1
    assert np.allclose(fast[4], poses[5], atol=1e-9)
    back = in_other_time(poses, 1.25, reverse=True)
    assert np.array_equal(back, fast[::-1])


def test_a_bow_moves_the_pelvis_back_and_keeps_the_balance() -> None:
    def bowed(figure):
        upper.bow(figure, np.full(len(figure), np.deg2rad(60.0)), 0.6, 0.3, 1.0)

    before, after = figure_and_clip(STAND, bowed)
    assert (after.qpos[:, 0] - before.qpos[:, 0] < -0.05).all()
    shift = figure_of(after.qpos).center - figure_of(before.qpos).center
    assert np.abs(shift).max() < 0.005
    chest = rot.quat_rotate(after.link_quat[:, 8], np.array([0.0, 0.0, 1.0]))
    pitch = np.rad2deg(np.arccos(chest[:, 2]))
    assert np.median(pitch) == pytest.approx(62.0, abs=5.0)


def test_a_crouch_lowers_the_root_over_feet_that_stay() -> None:
    def low(figure):
        upper.crouch(figure, np.full(len(figure), 0.25), 0.5)

    before, after = figure_and_clip(STAND, low)
    assert np.allclose(before.qpos[:, 2] - after.qpos[:, 2], 0.25, atol=0.005)
    feet = list(FOOT_LINKS)
    assert np.abs(before.link_position[:, feet] - after.link_position[:, feet]).max() < 0.005


def test_a_drifting_path_leads_elsewhere_and_its_stance_feet_do_not_slide() -> None:
    turn = stances.Drift(sideways=0.1, forwards=0.0, turning=0.4)
    before, after = figure_and_clip(WALK, lambda figure: stances.drift_path(figure, turn))
    turned = rot.heading(after.qpos[-1, 3:7]) - rot.heading(before.qpos[-1, 3:7])
    stepping = stances.steps(figure_of(default_poses(WALK))).sum() / FPS
    assert turned == pytest.approx(0.4 * stepping, abs=0.05)
    for foot in range(2):
        for first, last in stances.stances(before.contacts[:, foot]):
            was, now = (foot_speed(clip, foot, first, last) for clip in (before, after))
            assert now < was + 0.05


def test_wider_feet_stand_wider_and_the_body_stays_between_them() -> None:
    def wide(figure):
        stances.place_feet(figure, 0.2, 0.0, 0.0)

    before, after = figure_and_clip(STAND, wide)
    apart = [
        np.diff(clip.link_position[:, list(FOOT_LINKS), 1], axis=1) for clip in (before, after)
    ]
    assert np.allclose(apart[0] - apart[1], 0.2, atol=0.01)
    assert np.abs(after.qpos[:, 1] - before.qpos[:, 1]).max() < 0.01


def test_the_reaction_of_the_floor_is_that_of_mujocos_inverse_dynamics() -> None:
    force, pressure = feasible.reaction(WALK)
    model = build_body(WALK.height_m).model
    data = mujoco.MjData(model)
    acceleration = np.gradient(WALK.qvel, 1.0 / FPS, axis=0)
    weight = model.body_mass.sum() * 9.81
    for frame in range(20, len(WALK) - 20, 25):
        data.qpos[:], data.qvel[:] = WALK.qpos[frame], WALK.qvel[frame]
        data.qpos[2] += 5.0  # no floor near
        data.qacc[:] = acceleration[frame]
        mujoco.mj_inverse(model, data)
        assert np.allclose(data.qfrc_inverse[:3] / weight, force[frame], atol=0.03)
        torque = rot.quat_rotate(WALK.qpos[frame, 3:7], data.qfrc_inverse[3:6]) / weight
        x, y, z = WALK.qpos[frame, :3]
        own = force[frame]
        # The moment about the root of the force at the pressure's place.
        arm = np.array([pressure[frame, 0] - x, pressure[frame, 1] - y, -z])
        assert np.allclose(np.cross(arm, own)[:2], torque[:2], atol=0.02)


def test_a_body_that_leans_beyond_its_feet_is_not_carried_by_the_floor() -> None:
    standing = feasible.lacking(STAND)
    assert not feasible.unsupported(STAND, standing)

    def lean(figure):
        figure.center = figure.center + np.array([0.25, 0.0])

    _, leaning = figure_and_clip(STAND, lean)
    assert feasible.lacking(leaning)[1] > 0.05
    assert feasible.unsupported(leaning, standing)


def test_running_backwards_goes_and_walking_backwards_does_not() -> None:
    assert feasible.too_fast_backwards(JOG)
    slow = next(clip for clip in CLIPS if clip.name == "synthetic-walk-0.7")
    assert not feasible.too_fast_backwards(slow)
    rng = np.random.default_rng(0)
    drawn = [draw(JOG, rng) for _ in range(40)]
    assert all("reversed" not in recipe.amounts for recipe in drawn)


def test_joints_faster_than_peoples_and_soles_in_the_floor_are_seen() -> None:
    assert feasible.fast_joint(WALK) is None
    quick = WALK.qpos.copy()
    quick[::2, 7 + DOFS.index("left_elbow_y")] -= 0.0
    quick[40, 7 + DOFS.index("left_elbow_y")] -= 1.5
    assert feasible.fast_joint(clip_from_qpos("quick", quick, 1.75)) == "left_elbow_y"
    assert not feasible.in_the_floor(WALK)
    low = WALK.qpos.copy()
    low[50, 2] -= 0.03
    assert feasible.in_the_floor(clip_from_qpos("low", low, 1.75))


def test_licences_of_both_clips_stay() -> None:
    assert of_parts(("MIT", "MIT")) == "MIT"
    assert of_parts(("MIT", "CC-BY-NC-4.0")) == "CC-BY-NC-4.0"
    assert of_parts(("CC-BY-4.0", "CC-BY-NC-4.0")) == "CC-BY-4.0 AND CC-BY-NC-4.0"
    assert of_parts(("", "MIT")) == ""


def test_the_kind_is_named_after_the_greatest_ingredient() -> None:
    assert Recipe(1.0, {"lean": 0.05, "crouch": 0.4}).dominant == "crouch"
    assert Recipe(1.0, {}).dominant is None


def test_variations_that_are_varied_again_count_as_the_kind_of_their_source() -> None:
    kinds = ("stand", "stand+bow", "stand+lean", "stand+crouch+bow")
    standing = [replace(STAND, name=kind, kind=kind) for kind in kinds]
    made = vary([WALK, *standing], 40, seed=0)
    # Half of the draws are of the walk, not a fifth; more of them are rejected.
    assert sum(source_kind(clip.kind) == "walk" for clip in made) >= 9


def test_clips_of_other_proportions_are_refused_by_name() -> None:
    own_body = replace(WALK, proportions=Proportions())
    with pytest.raises(InputError, match="start-stop: variations are of the default body's"):
        vary([STAND, own_body], 1)


def test_a_clip_too_short_is_refused_by_name() -> None:
    short = clip_from_qpos("brief", WALK.qpos[:20], 1.75)
    with pytest.raises(InputError, match=r"brief: lasts 0\.53 s; variations need 1 s"):
        vary([short], 1)
    assert vary([WALK, short], 1)[0].name.startswith(WALK.name)


def test_clips_on_a_chair_are_not_varied() -> None:
    with pytest.raises(InputError, match="no clips to vary"):
        vary([replace(WALK, kind="sit")], 1)


def test_other_bodies_are_varied_at_their_own_height() -> None:
    tally = Tally()
    clip = vary([STAND.scaled(1.55)], 1, seed=3, tally=tally)[0]
    assert clip.height_m == 1.55 and tally.tried >= 1
    assert clip.qpos[0, 2] < 0.95 * 1.55 / 1.75


def test_the_command_writes_a_library(tmp_path, capsys) -> None:
    out = tmp_path / "more.npz"
    assert main(["motions", "vary", "synthetic:stand", "--out", str(out), "--count", "2"]) == 0
    clips = load_library(out).clips
    assert [clip.name.split("-vary-")[1] for clip in clips] == ["0-0", "0-1"]
    again = vary(load_motions("synthetic:stand"), 2)
    assert np.allclose(clips[1].qpos, again[1].qpos, atol=1e-5)
    assert "recipes rejected" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--count", "0"], "--count: is 0, not at least 1"),
        (["--seed", "-1"], "--seed: is -1, not at least 0"),
        (["--out", "more.bvh"], "a library's name ends in .npz"),
        (["--out", "no/such/more.npz"], "no such folder"),
    ],
)
def test_the_command_refuses_invalid_options_in_one_line(
    options, message, tmp_path, capsys, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = options if "--out" in options else ["--out", "x.npz", *options]
    assert main(["motions", "vary", "synthetic:stand", *given]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_an_interrupted_command_keeps_what_it_made(tmp_path, capsys, monkeypatch) -> None:
    made = vary([STAND], 2)

    def interrupted(*args, **kwargs):
        yield from made
        raise KeyboardInterrupt

    monkeypatch.setattr("agents.commands.vary.variations", interrupted)
    out = tmp_path / "part.npz"
    assert main(["motions", "vary", "synthetic:stand", "--out", str(out), "--count", "9"]) == 130
    assert len(load_library(out).clips) == 2
    assert "continue with --first 2 --count 7" in capsys.readouterr().out
