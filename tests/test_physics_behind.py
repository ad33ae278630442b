"""Physics behind a kinematic system: what the tracker is given, and what comes out."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agents.comparison.compare import compare
from agents.comparison.costs import plan_costs
from agents.comparison.options import CompareArgs
from agents.comparison.run import Plan, suiting
from agents.evaluation import EvaluateArgs, evaluate
from agents.evaluation.follow import evaluation_sim
from agents.evaluation.rollout import env_config
from agents.kinematic.interface import Poses
from agents.kinematic.physics_behind import (
    BEGINNING_FRAMES,
    TRACKER,
    avatar_samples,
    begun_as,
    follow_poses,
    on_own_body,
    reference_of,
    rollout_samples,
)
from agents.loading import load_agent
from agents.resolve import resolve
from agents.shipping.catalogue import catalogue, kept_families
from agents.shipping.families import families
from questsim.errors import InputError
from questsim.motion.kinematics import clip_from_qpos
from questsim.motion.library import save_library
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.pose_metrics import HEAD
from tests.helpers import swaying_clip

CLIP = swaying_clip(frames=30)
MOTION = to_motion(CLIP).resampled(60.0)


def poses_of(motion, scale=1.0) -> Poses:
    offsets = np.broadcast_to(scale * motion.offsets, (len(motion), 22, 3))
    return Poses(scale * motion.root_position, motion.rotations, offsets)


def test_poses_of_an_estimated_body_are_put_on_the_measured_one_by_the_head():
    poses = poses_of(MOTION, scale=0.9)
    own = on_own_body(poses, MOTION)
    assert np.array_equal(own.offsets, MOTION.offsets)
    head = poses.forward_kinematics()[0][:, HEAD]
    np.testing.assert_allclose(own.forward_kinematics()[0][:, HEAD], head, atol=1e-9)


def test_poses_of_the_measured_body_stay_where_they_are():
    own = on_own_body(poses_of(MOTION), MOTION)
    np.testing.assert_allclose(own.root_position, MOTION.root_position, atol=1e-9)


def test_the_tracker_sees_no_frame_more_than_six_frames_ahead():
    seen, frame = [], 8
    for changed in (None, frame + 6, frame + 7):
        qpos = CLIP.qpos.copy()
        if changed is not None:
            qpos[changed:, 7:] += 0.1
        clip = clip_from_qpos("clip", qpos, CLIP.height_m)
        sim = evaluation_sim([clip], env_config(load_agent(TRACKER)))
        sim.reset()
        for _ in range(frame):
            sim.step(np.zeros((1, 33), np.float32))
        seen.append(sim.observation[0, sim.layout["privileged"]].copy())
        sim.close()
    assert not np.array_equal(seen[0], seen[1])
    assert np.array_equal(seen[0], seen[2])


def test_the_avatar_is_scored_against_the_users_motion_not_the_estimate():
    wrong = replace(MOTION, root_position=MOTION.root_position + np.array([0.03, 0.0, 0.0]))
    (rollout,) = follow_poses([reference_of(poses_of(wrong), MOTION)], [MOTION])
    truth = to_clip(MOTION)
    np.testing.assert_allclose(rollout.reference.qpos, truth.qpos)
    samples = rollout_samples(rollout)
    assert samples["success_percent"].item() == 100.0
    assert samples["world_cm"][0] == pytest.approx(0.0, abs=0.1)  # it begins as the user does
    assert samples["world_cm"][-1] == pytest.approx(3.0, abs=0.5)  # and goes where it is told
    assert samples["pos_cm"].mean() < 3.0


def test_an_avatar_begins_in_the_users_own_state_whatever_the_estimate_begins_with():
    truth = to_clip(MOTION)
    turned = truth.qpos.copy()
    turned[:, 7:] += 0.3
    estimate = clip_from_qpos("estimate", turned, truth.height_m, kind="walk")
    (rollout,) = follow_poses([estimate], [MOTION])
    np.testing.assert_allclose(rollout.qpos[0], truth.qpos[0], atol=1e-6)
    assert rollout.kind == truth.kind


def test_an_avatar_begins_in_the_users_state_and_then_sees_only_estimates():
    truth = to_clip(MOTION)
    turned = truth.qpos.copy()
    turned[:, 7:] += 0.3
    estimate = clip_from_qpos("estimate", turned, truth.height_m, kind="walk")
    begun = begun_as(estimate, truth)
    np.testing.assert_allclose(begun.qpos[0], truth.qpos[0], atol=1e-9)
    np.testing.assert_allclose(begun.qpos[BEGINNING_FRAMES:], estimate.qpos[BEGINNING_FRAMES:])
    off = np.abs(begun.qpos[:, 7:] - estimate.qpos[:, 7:]).max(axis=1)
    assert (np.diff(off[: BEGINNING_FRAMES + 1]) < 0).all()
    assert begun.kind == "walk"
    other = truth.qpos.copy()
    other[2:, 7:] += 1.0  # central differences: the first velocity knows frame 1
    later = clip_from_qpos("later", other, truth.height_m)
    np.testing.assert_array_equal(begun_as(estimate, later).qpos, begun.qpos)


def test_an_avatar_lost_at_once_has_no_samples_but_its_failure():
    truth = to_clip(MOTION)
    short = clip_from_qpos("short", truth.qpos[:2], truth.height_m)
    assert avatar_samples(short, truth) == {}
    exact = avatar_samples(truth, truth)
    assert exact["mpjpe_cm"].max() == 0.0 and exact["rot_deg"].max() < 1e-3


def test_a_comparison_has_the_system_without_and_with_physics_and_the_policy(tmp_path):
    motions, out = tmp_path / "motions.npz", tmp_path / "scores"
    save_library(motions, [to_motion(CLIP)], [])
    agents = ("ik", "ik+physics", "demo")
    args = CompareArgs(agents=agents, motions=str(motions), out=out, threads=1)
    assert compare(args) == 0
    rows = json.loads((out / "comparison.json").read_text())["rows"][1:]
    found = [(row["agent"], row["scenario"]) for row in rows]
    assert found == [
        ("ik", "6"), ("ik+physics", "6, no physics"), ("ik+physics", "6"), ("demo", "HMD"),
    ]  # fmt: skip
    told = [row["pooled"].get("success_percent") for row in rows]
    assert told[:3] == [None, None, 100.0] and told[3] is not None
    # Who stands on the floor needs nothing that pulls at the pelvis.
    assert all(row["pooled"]["root_force_bw"] < 0.05 for row in rows)
    assert rows[2]["parameters"] > rows[1]["parameters"] == 0


def test_a_system_with_physics_takes_the_time_of_the_system_and_that_of_the_avatar():
    agent = resolve("ik+physics")
    (scenario,) = suiting(agent)
    measured: dict[str, float | None] = {f"ik: {scenario.name}": 2.0, TRACKER: 1.0}
    measured["retargeting"] = 0.5
    plan = Plan(agent, scenario, None, ("estimate", "user"))
    times = [costs.ms for costs in plan_costs(plan, [MOTION], measured)]
    # 36 frames of the avatar in the time of 60 of the system.
    assert times == pytest.approx([2.0, 2.9, 2.9])


def test_an_evaluation_of_a_system_with_physics_writes_the_report_of_the_policies(tmp_path):
    motions, out = tmp_path / "motions.npz", tmp_path / "scores"
    save_library(motions, [to_motion(CLIP)], [])
    args = EvaluateArgs(agent="ik+physics", motions=str(motions), out=out, threads=1)
    assert evaluate(args) == 0
    report = json.loads((out / "metrics.json").read_text())
    assert report["context"]["agent"] == "ik+physics"
    assert report["all"]["success"] == 1.0 and report["all"]["mpjpe_cm"] < 5.0
    with pytest.raises(InputError, match="--terrain: does not go with ik"):
        evaluate(replace(args, terrain="rough"))
    with pytest.raises(InputError, match="nobody: is not a kinematic system"):
        evaluate(replace(args, agent="nobody+physics"))


def test_systems_that_are_there_are_listed_with_physics_behind_them():
    entries = {(entry["agent"], entry["preset"]): entry for entry in catalogue()}
    listed = entries["ik+physics", "-"]
    assert listed["licence"] == entries[TRACKER, entries_preset(entries)]["licence"]
    assert listed["licence"].startswith("CC-BY-NC-4.0") and listed["sensors"] == ["6T"]
    assert listed["parameters"] == entries[TRACKER, entries_preset(entries)]["parameters"]
    assert entries[TRACKER, entries_preset(entries)]["sensors"] == ["reference"]
    for (agent, preset), entry in entries.items():
        if preset not in ("-", "cpu") and agent in ("hmdposer", "lgsik"):
            assert (f"{agent}+physics", preset) not in entries, entry["title"]


def entries_preset(entries) -> str:
    return next(preset for agent, preset in entries if agent == TRACKER)


def test_the_kept_table_of_families_is_that_of_the_code():
    assert kept_families() == families()  # else: python -m agents.shipping.families
