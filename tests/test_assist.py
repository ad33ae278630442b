"""The assist: bounded, off while the avatar keeps up, fading in and out, and what its parts do."""

import numpy as np
import pytest

from agents.agent import ZeroAgent
from agents.evaluation.assisted import AssistUse, user_headsets
from agents.evaluation.follow import evaluation_sim
from agents.evaluation.rollout import env_config, roll_out
from agents.loading import load_agent
from envs.assist import (
    ENGAGE_M,
    FADE_S,
    FORESIGHT_S,
    RELEASE_M,
    Assist,
    _beyond_feet,
    _wanted_lean,
    headsets,
)
from envs.config import EnvConfig
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.motion.synthesis.synthetic import synthetic_clips
from questsim.sensors import device_poses
from questsim.skeleton import FOOT_LINKS

CLIPS = {clip.name: clip for clip in synthetic_clips()}
AHEAD = np.array([[1.0, 0.0, 0.0, 0.0]])


def shares(assist, away_m):
    """Fade of the assist after each frame, with the user this far ahead in turn."""
    own, out = headsets(assist._sim), []
    for metres in away_m:
        assist.apply(own + np.array([metres, 0.0, 0.0]), AHEAD)
        out.append(float(assist.share[0]))
    return np.array(out)


@pytest.fixture
def standing():
    """An avatar that stands, and does not move while its simulation is not stepped."""
    sim = evaluation_sim([CLIPS["synthetic-stand-1"]], EnvConfig(fixed_start=True))
    sim.reset()
    yield sim
    sim.close()


def test_the_assist_fades_in_beyond_its_distance_and_out_when_the_avatar_is_back(standing):
    assist, step = Assist(standing, 300.0), 1.0 / (FADE_S * FPS)
    assert not shares(assist, [0.96 * ENGAGE_M] * 9).any()
    rise = shares(assist, [1.04 * ENGAGE_M] * 5)
    assert np.diff([0.0, *rise]) == pytest.approx([step, step, step, 1.0 - 3.0 * step, 0.0])
    assert shares(assist, [1.1 * RELEASE_M] * 5) == pytest.approx(1.0)  # between the two: stays
    fall = shares(assist, [0.9 * RELEASE_M] * 6)
    assert np.diff(fall)[:4] == pytest.approx([-step] * 3 + [3.0 * step - 1.0])
    assert fall[-1] == 0.0 and standing.renew_forces is None and not assist.force.any()


def test_the_assist_comes_in_early_when_the_avatar_will_be_too_far_away(standing):
    assist, speed = Assist(standing, 300.0), 0.5
    away = np.arange(20) * speed / FPS
    first = int(np.flatnonzero(shares(assist, away))[0])
    assert away[first - 1] <= ENGAGE_M - FORESIGHT_S * speed < away[first] + 1e-9
    assert away[first] < 0.5 * ENGAGE_M


def test_the_assist_holds_a_limp_avatar_up_for_longer_and_stays_within_its_bound():
    clips = [CLIPS["synthetic-stand-1"]]
    config = env_config(ZeroAgent())
    alone, fallen = roll_out(ZeroAgent(), clips, config)[0], AssistUse(0.0)
    watched = roll_out(ZeroAgent(), clips, config, assist=fallen)[0]
    np.testing.assert_array_equal(watched.link_position, alone.link_position)
    assert fallen.figures()["upright_percent"] == 0.0 and fallen.figures()["peak_n"] == 0.0
    use = AssistUse(1500.0)
    helped = roll_out(ZeroAgent(), clips, config, assist=use)[0]
    assert alone.fell and len(helped) > 1.3 * len(alone)
    figures = use.figures()
    assert 0.0 < figures["mean_n"] <= figures["peak_n"] <= 1500.0 + 1e-6
    assert figures["clips_percent"] == 100.0 and figures["time_percent"] > 10.0


def test_an_avatar_that_keeps_up_is_not_helped():
    agent, use = load_agent("questsim"), AssistUse(300.0)
    clips = [CLIPS["synthetic-stand-1"]]
    helped = roll_out(agent, clips, env_config(agent), assist=use)[0]
    alone = roll_out(agent, clips, env_config(agent))[0]
    assert use.figures()["time_percent"] == 0.0 and use.figures()["mean_n"] is None
    assert use.figures()["upright_percent"] == 100.0
    np.testing.assert_array_equal(helped.link_position, alone.link_position)


def test_the_assist_reads_the_user_of_an_avatar_of_another_stature():
    user = CLIPS["synthetic-walk-1.2-start-stop"]
    sim = evaluation_sim([user], EnvConfig(unscaled_m=0.2, fixed_start=True))
    sim.reset()
    sim.step(np.zeros((1, 33)))
    position, quat = user_headsets(sim)
    true, turned = device_poses(
        user.link_position[1], user.link_quat[1], ["headset"], user.height_m
    )
    np.testing.assert_allclose(position, true, atol=1e-5)
    np.testing.assert_allclose(np.abs((quat * turned).sum()), 1.0, atol=1e-6)
    sim.close()


def test_the_assist_adds_to_a_push_on_the_pelvis_and_never_pushes_down():
    sim = evaluation_sim([CLIPS["synthetic-stand-1"]], EnvConfig(fixed_start=True))
    sim.reset()
    assist = Assist(sim, 0.001)
    sim.pusher.push(0, np.array([100.0, 0.0, 0.0]), 1.0, "pelvis")
    far = headsets(sim) + np.array([1.0, 1.0, -1.0])
    for _ in range(3):
        assist.apply(far, np.array([[1.0, 0.0, 0.0, 0.0]]))
        sim.step(np.zeros((1, 33)))
    wrench = sim.batch.bind("xfrc_applied")[0, 1]
    assert 0.0 < np.linalg.norm(assist.force[0]) <= 0.001 and assist.force[0, 2] == 0.0
    np.testing.assert_allclose(wrench[:3], [100.0, 0.0, 0.0], atol=0.001)
    sim.close()


def test_the_assist_pulls_the_centre_of_mass_over_the_feet(monkeypatch):
    for gain in ("_STIFFNESS", "_DAMPING", "_LIFT_STIFFNESS", "_LIFT_DAMPING"):
        monkeypatch.setattr(f"envs.assist.{gain}", 0.0)
    sim = evaluation_sim([CLIPS["synthetic-stand-1"]], EnvConfig(fixed_start=True))
    sim.reset()
    assist = Assist(sim, 2000.0)
    assist.share[:] = 1.0
    far = headsets(sim) + np.array([1.0, 0.0, 0.0])
    assist.apply(far, np.array([[1.0, 0.0, 0.0, 0.0]]))
    assist._centres = sim.batch.bind("subtree_com").copy()
    centre = assist._centres[0, 1]
    feet = sim.link_positions[0, FOOT_LINKS].mean(axis=0)  # nothing has been loaded yet
    centre += [0.2, -0.1, 0.0]  # forward and to the right of the feet
    assert sim.renew_forces is not None
    sim.renew_forces()
    # Half of the weight times the distance over the height of the centre.
    wanted = 0.5 * 9.81 * sim.masses[0] / centre[2] * (feet - centre)[:2]
    wrench = sim.batch.bind("xfrc_applied")[0, 1]
    np.testing.assert_allclose(wrench[:3], [*wanted, 0.0], rtol=1e-6)
    assert wrench[0] < 0.0 < wrench[1]
    sim.close()


def test_a_centre_of_mass_counts_from_a_step_beyond_the_place_between_the_feet():
    feet = np.array([[[1.0, 0.2], [1.0, -0.2]]] * 5)
    centre = np.array([[1.0, 0.1], [1.09, 0.0], [1.4, 0.1], [1.0, -0.6], [0.7, 0.6]])
    feet[4, 1] = feet[4, 0]  # both at one place
    level = np.concatenate([centre, np.full((5, 1), 0.9)], axis=1)
    wanted = [[0, 0, 0], [0, 0, 0], [0.3, 0, 0], [0, -0.3, 0], [-0.24, 0.32, 0]]
    np.testing.assert_allclose(_beyond_feet(level, feet), wanted, atol=1e-9)


def test_the_torque_turns_a_body_back_over_feet_that_stay_behind(standing, monkeypatch):
    for gain in ("_UPRIGHTING", "_UPRIGHT_DAMPING", "_TURNING"):
        monkeypatch.setattr(f"envs.assist.{gain}", 0.0)
    assist = Assist(standing, 2000.0)
    assist.share[:] = 1.0
    assist.apply(headsets(standing) + np.array([1.0, 0.0, 0.0]), AHEAD)
    assist._centres = standing.batch.bind("subtree_com").copy()
    feet = standing.link_positions[0, FOOT_LINKS]
    across = (feet[0] - feet[1])[:2] / np.linalg.norm((feet[0] - feet[1])[:2])
    assist._centres[0, 1, :2] = feet.mean(axis=0)[:2] + 0.3 * np.array([across[1], -across[0]])
    assert standing.renew_forces is not None
    standing.renew_forces()
    wrench = standing.batch.bind("xfrc_applied")[0, 1]
    # 0.3 m ahead of the feet, of which 0.1 m are a step: the body is turned backwards.
    moment = 10.0 * standing.masses[0] * 0.2
    np.testing.assert_allclose(wrench[3:], [*(-moment * across), 0.0], atol=1e-6)


def test_the_trunk_is_turned_upright_and_that_of_a_bent_user_neither_back_nor_aside():
    ahead = np.array([0.0, np.pi / 2.0])  # one looks along x, one along y
    lean = np.array([[-0.6, 0.0, 0.8], [0.6, 0.0, 0.8]])
    up = [[0.0, 0.0, 1.0]] * 2
    np.testing.assert_allclose(_wanted_lean(lean, ahead, np.ones((2, 1))), up)
    bent = np.zeros((2, 1))
    least = [[0.3, 0.0, 0.91**0.5], [0.0, 0.3, 0.91**0.5]]
    np.testing.assert_allclose(_wanted_lean(lean, ahead, bent), least, atol=1e-12)
    deep = np.array([[0.8, 0.0, 0.6], [0.0, 0.8, 0.6]])  # both bend forward: kept
    np.testing.assert_allclose(_wanted_lean(deep, ahead, bent), deep, atol=1e-12)


@pytest.mark.parametrize("bound", [-1.0, 5000.0, np.nan])
def test_an_assist_out_of_range_is_refused(bound):
    with pytest.raises(InputError, match="not within 0 and 2000 N"):
        AssistUse(bound)
