from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rollouts import moving_clip, rollout, shifted, still_clip, turned
from scipy.spatial.transform import Rotation

from questsim import metrics_terms as terms
from questsim.errors import InputError
from questsim.metrics import METRICS, evaluate, samples, sole_spheres, summarise
from questsim.skeleton import FOOT_LINKS, LINK_PARENTS, LINKS

LEFT_FOOT = LINKS.index("left_foot")


def figure(name, *rollouts) -> float:
    value = summarise(rollouts)[name]
    assert value is not None
    return value


# Perfect tracking


def test_a_perfect_rollout_has_no_error():
    clip = moving_clip()
    figures = summarise([rollout(clip)])
    errors = [name for name in METRICS if "jitter" not in name and "skate" not in name]
    assert {name: figures[name] for name in errors} == pytest.approx(
        dict.fromkeys(errors, 0.0), abs=1e-6
    )
    assert figures["success"] == 1.0
    assert figures["jitter_km_s3"] == figures["reference_jitter_km_s3"] != 0.0


# Positions


def test_mpjpe_is_the_mean_distance_over_links_in_cm():
    clip = still_clip()
    position = clip.link_position.copy()
    position[:, 3] += [0.03, 0.0, 0.04]  # one link of 16 is 5 cm off
    moved = rollout(clip, link_position=position)
    assert figure("mpjpe_cm", moved) == pytest.approx(5.0 / 16)
    assert figure("mpjpe_root_aligned_cm", moved) == pytest.approx(5.0 / 16)
    assert figure("root_cm", moved) == pytest.approx(0.0)


def test_root_alignment_takes_the_pelvis_error_off_every_link():
    clip = still_clip()
    position = clip.link_position.copy()
    position[:, 0, 0] += 0.08
    off = rollout(clip, link_position=position)
    assert figure("root_cm", off) == pytest.approx(8.0)
    assert figure("mpjpe_cm", off) == pytest.approx(8.0 / 16)
    assert figure("mpjpe_root_aligned_cm", off) == pytest.approx(8.0 * 15 / 16)


@given(st.tuples(*[st.floats(-0.25, 0.25)] * 3))
def test_a_shift_changes_mpjpe_by_its_length_and_the_aligned_error_not_at_all(shift):
    clip, other = moving_clip(), moving_clip(seed=0)
    moved = rollout(clip, link_position=shifted(other, shift))
    assert figure("mpjpe_cm", moved) == pytest.approx(100 * np.linalg.norm(shift), abs=1e-9)
    assert figure("mpjpe_root_aligned_cm", moved) == pytest.approx(0.0, abs=1e-9)
    assert figure("mhpe_cm", moved) == pytest.approx(100 * np.linalg.norm(shift), abs=1e-9)
    assert figure("mpjve_cm_s", moved) == pytest.approx(0.0, abs=1e-7)
    assert figure("mpjre_deg", moved) == pytest.approx(0.0, abs=1e-6)


def test_positions_agree_with_a_second_implementation():
    clip, other = moving_clip(seed=1), moving_clip(seed=2)
    p = clip.link_position + 0.1 * (other.link_position - clip.link_position)
    r, frames, fps = clip.link_position, len(clip), 36.0
    distances, aligned, jerks, speeds = [], [], [], []
    for link in range(16):
        for f in range(frames):
            distances.append(sum((p[f, link] - r[f, link]) ** 2) ** 0.5)
            aligned.append(sum((p[f, link] - p[f, 0] - r[f, link] + r[f, 0]) ** 2) ** 0.5)
            if f >= 1:
                v = [(x[f, link] - x[f - 1, link]) * fps for x in (p, r)]
                speeds.append(sum((v[0] - v[1]) ** 2) ** 0.5)
            if f >= 3:
                j = p[f, link] - 3 * p[f - 1, link] + 3 * p[f - 2, link] - p[f - 3, link]
                jerks.append(sum((j * fps**3) ** 2) ** 0.5)
    figures = summarise([rollout(clip, link_position=p)])
    assert figures["mpjpe_cm"] == pytest.approx(100 * np.mean(distances))
    assert figures["mpjpe_root_aligned_cm"] == pytest.approx(100 * np.mean(aligned))
    assert figures["mpjve_cm_s"] == pytest.approx(100 * np.mean(speeds))
    assert figures["jitter_km_s3"] == pytest.approx(np.mean(jerks) / 1000)


# Derivatives


def test_mpjve_of_an_avatar_that_slides_away_at_9_cm_s():
    clip = still_clip()
    away = np.arange(len(clip))[:, None, None] * np.array([0.09 / 36, 0.0, 0.0])
    assert figure("mpjve_cm_s", rollout(clip, link_position=clip.link_position + away)) == (
        pytest.approx(9.0)
    )


def test_jitter_of_a_cubic_path_is_its_constant_third_derivative():
    clip = still_clip(frames=12)
    seconds = np.arange(12)[:, None, None] / 36
    position = clip.link_position + seconds**3 * np.array([0.0, 0.0, 2.0])  # jerk 12 m/s^3
    figures = summarise([rollout(clip, link_position=position)])
    assert figures["jitter_km_s3"] == pytest.approx(0.012)
    assert figures["reference_jitter_km_s3"] == pytest.approx(0.0, abs=1e-9)


def test_jitter_needs_four_frames_and_three_are_left_out():
    three, four = still_clip(3), still_clip(4)
    assert summarise([rollout(three)])["jitter_km_s3"] is None
    assert summarise([rollout(four)])["jitter_km_s3"] == pytest.approx(0.0, abs=1e-9)
    shaken = four.link_position + np.array([0, 1, 0, 0])[:, None, None] * [0.0, 0.0, 0.001]
    assert figure("jitter_km_s3", rollout(four, link_position=shaken), rollout(three)) == (
        pytest.approx(3 * 0.001 * 36**3 / 1000)
    )


# Rotations


def test_turning_the_pelvis_alone_costs_its_three_children_their_local_angle():
    clip = still_clip()
    off = rollout(clip, link_quat=turned(clip.link_quat, [0], 30.0))
    children = sum(parent == 0 for parent in LINK_PARENTS[1:])
    assert children == 3
    assert figure("mpjre_deg", off) == pytest.approx(30.0 * children / 15)
    assert figure("root_deg", off) == pytest.approx(30.0)
    assert figure("sip_deg", off) == pytest.approx(0.0, abs=1e-6)


def test_turning_the_whole_avatar_costs_no_local_angle():
    clip = moving_clip()
    off = rollout(clip, link_quat=turned(clip.link_quat, list(range(16)), 25.0))
    assert figure("mpjre_deg", off) == pytest.approx(0.0, abs=1e-6)
    assert figure("sip_deg", off) == pytest.approx(25.0)
    assert figure("mhre_deg", off) == pytest.approx(25.0)


@pytest.mark.parametrize(
    ("link", "share"),
    [("left_thigh", 0.25), ("right_upper_arm", 0.25), ("left_shin", 0), ("right_forearm", 0)],
)
def test_sip_looks_at_thighs_and_upper_arms(link, share):
    clip = still_clip()
    off = rollout(clip, link_quat=turned(clip.link_quat, [LINKS.index(link)], 40.0))
    assert figure("sip_deg", off) == pytest.approx(40.0 * share, abs=1e-6)


def test_a_quaternion_and_its_negative_are_the_same_rotation():
    clip = moving_clip()
    figures = summarise([rollout(clip, link_quat=-clip.link_quat)])
    assert figures["mpjre_deg"] == pytest.approx(0.0, abs=1e-6)
    assert figures["mhre_deg"] == pytest.approx(0.0, abs=1e-6)


def test_rotations_agree_with_a_second_implementation():
    clip, other = moving_clip(seed=3), moving_clip(seed=4)
    wanted = ("left_thigh", "right_thigh", "left_upper_arm", "right_upper_arm")
    local, sip, root = [], [], []
    for f in range(len(clip)):
        a = [Rotation.from_quat(q, scalar_first=True) for q in other.link_quat[f]]
        b = [Rotation.from_quat(q, scalar_first=True) for q in clip.link_quat[f]]
        root.append((a[0].inv() * b[0]).magnitude())
        for link, name in enumerate(LINKS):
            if link:
                mine = a[LINK_PARENTS[link]].inv() * a[link]
                theirs = b[LINK_PARENTS[link]].inv() * b[link]
                local.append((mine.inv() * theirs).magnitude())
            if name in wanted:
                sip.append((a[link] * b[link].inv()).magnitude())
    # The positions are the clip's own: only orientations differ, so no frame counts as lost.
    figures = summarise([rollout(clip, link_quat=other.link_quat)])
    assert figures["mpjre_deg"] == pytest.approx(np.degrees(np.mean(local)))
    assert figures["sip_deg"] == pytest.approx(np.degrees(np.mean(sip)))
    assert figures["root_deg"] == pytest.approx(np.degrees(np.mean(root)))


# Devices


def test_device_errors_are_the_mean_over_headset_and_controllers():
    clip = still_clip()
    hand = LINKS.index("left_hand")
    off = rollout(clip, link_quat=turned(clip.link_quat, [hand], 90.0))
    # The controller lies 8 cm down the hand: turned by 90 degrees it is 8 * sqrt(2) cm off.
    assert figure("mhpe_cm", off) == pytest.approx(8 * 2**0.5 / 3)
    assert figure("mhre_deg", off) == pytest.approx(90.0 / 3)


def test_device_offsets_scale_with_height():
    small, hand = still_clip(height_m=1.4), LINKS.index("left_hand")
    off = rollout(small, link_quat=turned(small.link_quat, [hand], 90.0))
    assert figure("mhpe_cm", off) == pytest.approx(8 * 2**0.5 / 3 * 1.4 / 1.75)


# Feet


def sliding(clip, speed_m_s):
    away = np.arange(len(clip))[:, None, None] * np.array([0.6, 0.8, 0.0]) * speed_m_s / 36
    return clip.link_position + away


def test_skating_is_the_speed_of_a_foot_that_bears():
    clip = still_clip()
    force = np.zeros((len(clip), 2))
    force[:, 0] = 300.0
    assert figure(
        "foot_skate_cm_s",
        rollout(clip, link_position=sliding(clip, 0.2), contact_force=force),
    ) == pytest.approx(20.0)


def test_a_foot_without_load_does_not_skate():
    clip = still_clip()
    position = sliding(clip, 0.2)
    position[:, FOOT_LINKS[1]] = clip.link_position[:, FOOT_LINKS[1]]
    force = np.tile([9.9, 300.0], (len(clip), 1))  # the left one slides, unloaded
    off = rollout(clip, link_position=position, contact_force=force)
    assert figure("foot_skate_cm_s", off) == pytest.approx(0.0, abs=1e-9)
    lifted = rollout(clip, contact_force=np.zeros((len(clip), 2)))
    assert summarise([lifted])["foot_skate_cm_s"] is None


def test_skating_needs_contact_in_both_frames():
    clip = still_clip(frames=5)
    force = np.array([[300.0, 0], [300.0, 0], [0, 0], [300.0, 0], [0, 0]])
    assert len(samples(rollout(clip, contact_force=force))["foot_skate_cm_s"]) == 1


def test_without_forces_a_foot_near_the_floor_bears():
    clip = still_clip()
    shown = {"link_position": sliding(clip, 0.2), "contact_force": None}
    height = np.tile([0.004, 0.006], (len(clip), 1))
    kinematic = rollout(clip, foot_clearance=height, **shown)
    assert len(samples(kinematic)["foot_skate_cm_s"]) == len(clip) - 1
    assert figure("foot_skate_cm_s", kinematic) == pytest.approx(20.0)


def test_a_heel_that_rises_as_the_foot_rolls_over_its_ball_does_not_skate():
    centres, radius = sole_spheres(1.75)
    ball = centres[0, centres[0, :, 0].argmax()]
    angle = np.radians(np.linspace(0, 45, 10))
    quat = Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0]).as_quat(scalar_first=True)
    # The sphere at the ball rolls forward without slipping: its centre moves by radius * angle.
    centre = np.stack([radius * angle, 0 * angle, 0 * angle + radius], axis=-1)
    ankle = centre - Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0]).apply(ball)
    position = np.repeat(ankle[:, None], 2, axis=1)
    slip = terms.foot_skate_cm_s(
        position, np.repeat(quat[:, None], 2, axis=1), np.ones((10, 2), bool), (centres, radius), 36
    )
    ankle_speed = np.linalg.norm(np.diff(ankle, axis=0), axis=-1) * 36 * 100
    assert ankle_speed.min() > 40.0
    assert slip.max() < 0.5


@pytest.mark.parametrize("height_m", [1.4, 1.75, 2.1])
def test_soles_of_any_height_touch_the_floor_where_the_avatar_stands(height_m):
    clip = still_clip(height_m=height_m)
    centres, radius = sole_spheres(height_m)
    feet = clip.link_position[0, list(FOOT_LINKS)]
    lowest = feet[:, None, 2] + centres[..., 2] - radius
    assert lowest == pytest.approx(np.zeros((2, 4)), abs=1e-9)


def test_penetration_is_the_depth_of_the_deeper_foot():
    clip = still_clip(frames=2)
    clearance = np.array([[-0.02, -0.01], [0.03, 0.01]])
    assert figure("penetration_cm", rollout(clip, foot_clearance=clearance)) == pytest.approx(1.0)


# Falls and groups


def test_frames_count_until_the_avatar_is_lost():
    clip = still_clip(frames=10)
    position = shifted(clip, (0.1, 0.0, 0.0))
    position[6:, :, 0] += 0.5
    lost = rollout(clip, link_position=position, fell=True)
    figures = summarise([lost])
    assert (figures["frames"], figures["success"]) == (6, 0.0)
    assert figures["mpjpe_cm"] == pytest.approx(10.0)


def test_leaving_half_a_metre_is_no_success_even_if_the_simulation_went_on():
    clip = still_clip(frames=10)
    position = clip.link_position.copy()
    position[4] += [0.51, 0.0, 0.0]
    assert not rollout(clip, link_position=position, fell=False).completed
    position[4] -= [0.02, 0.0, 0.0]
    assert rollout(clip, link_position=position, fell=False).completed


def test_a_rollout_lost_in_its_first_frame_gives_no_sample():
    clip = still_clip(frames=4)
    lost = rollout(clip, link_position=shifted(clip, (1.0, 0.0, 0.0)), fell=True)
    figures = summarise([lost])
    assert (figures["clips"], figures["frames"], figures["success"]) == (1, 0, 0.0)
    assert figures["mpjpe_cm"] is None and figures["penetration_cm"] is None


def test_a_long_clip_weighs_by_its_frames():
    short, long = still_clip(frames=10), still_clip(frames=30)
    off = rollout(short, link_position=shifted(short, (0.2, 0.0, 0.0)))
    assert figure("mpjpe_cm", off, rollout(long)) == pytest.approx(20.0 * 10 / 40)


def test_real_time_factor_is_time_simulated_over_time_taken():
    clip = still_clip()
    a = rollout(clip, seconds_simulated=6.0, seconds_wall=0.5)
    b = rollout(clip, seconds_simulated=2.0, seconds_wall=1.5)
    assert figure("real_time_factor", a, b) == pytest.approx(4.0)
    assert summarise([rollout(clip, seconds_wall=0.0)])["real_time_factor"] is None


def test_completed_clips_are_a_group_of_their_own():
    clip = still_clip(frames=10)
    good = rollout(clip, link_position=shifted(clip, (0.01, 0.0, 0.0)))
    bad = rollout(clip, frames=5, fell=True)
    metrics = evaluate([good, bad])
    assert metrics["all"]["success"] == 0.5
    assert (metrics["all"]["frames"], metrics["completed"]["frames"]) == (15, 10)
    assert metrics["all"]["mpjpe_cm"] == pytest.approx(1.0 * 10 / 15)
    assert metrics["completed"]["mpjpe_cm"] == pytest.approx(1.0)
    assert metrics["completed"]["success"] == 1.0


def test_no_completed_clip_gives_null_figures():
    metrics = evaluate([rollout(still_clip(), fell=True)])
    assert metrics["completed"]["clips"] == metrics["completed"]["frames"] == 0
    left = {k: v for k, v in metrics["completed"].items() if k not in ("clips", "frames")}
    assert set(left.values()) == {None}
    assert set(METRICS) < set(left)


def test_clips_are_grouped_by_kind_and_by_style():
    walk = still_clip(kind="walk", style="old")
    run = still_clip(kind="run", style="old")
    metrics = evaluate(
        [rollout(walk), rollout(run, fell=True), rollout(run), rollout(still_clip())]
    )
    assert list(metrics["by_kind"]) == ["run", "unknown", "walk"]
    assert metrics["by_kind"]["run"]["all"]["success"] == 0.5
    assert metrics["by_kind"]["run"]["completed"]["clips"] == 1
    assert metrics["by_style"]["old"]["all"]["clips"] == 3
    assert metrics["by_kind"]["walk"]["all"].keys() == metrics["all"].keys()


# Refusals


@pytest.mark.parametrize(
    "field", ["link_position", "link_quat", "joint_angles", "foot_clearance", "contact_force"]
)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_is_not_finite_is_refused(field, value):
    good = rollout(still_clip())
    array = getattr(good, field).copy()
    array[5].flat[0] = value
    with pytest.raises(InputError, match=rf"{field} is not finite at frame 5"):
        replace(good, **{field: array})


def test_a_reference_that_is_not_finite_is_refused_where_it_is_compared():
    clip = still_clip(frames=8)
    position = clip.link_position.copy()
    position[6, 2, 1] = np.nan
    broken = replace(clip, link_position=position)
    with pytest.raises(InputError, match="reference link_position is not finite at frame 6"):
        rollout(broken, clip)
    assert summarise([rollout(broken, clip, frames=6)])["frames"] == 6


def test_shapes_lengths_and_quaternions_are_checked():
    clip = still_clip(frames=8)
    with pytest.raises(InputError, match=r"link_quat has shape \(8, 15, 4\)"):
        rollout(clip, link_quat=clip.link_quat[:, 1:])
    with pytest.raises(InputError, match="9 simulated frames for 8 of the clip"):
        rollout(clip, still_clip(frames=9))
    with pytest.raises(InputError, match="unit length at frame 0"):
        rollout(clip, link_quat=0.0 * clip.link_quat)
    with pytest.raises(InputError, match="no clips were evaluated"):
        evaluate([])
