"""The comparison of kinematic systems, and the list of agents."""

import csv
import json
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch
from PIL import Image

from agents.comparison import run as run_module
from agents.comparison.behind import body_of
from agents.comparison.compare import FIGURES, FILES, CompareArgs, compare, plan, shipped_agents
from agents.comparison.conditions import Start, condition_of, row_name
from agents.comparison.drawn import (
    _over_time,
    compared,
    first_starts,
    predictor_over_time,
    predictor_pairs,
)
from agents.comparison.plots import KINDS, kind_of
from agents.comparison.record import Record
from agents.comparison.report import Costs, Row, row_of, table
from agents.comparison.summary import CURVE_BINS, Summary, sums_of
from agents.evaluation import EvaluateArgs, evaluate
from agents.kinematic import load_system
from agents.kinematic.causal import causal_clip
from agents.kinematic.data import MotionBank
from agents.kinematic.device_faults import NOISES, faulty, noisy
from agents.kinematic.efficiency import mmac_a_frame, stream_kib
from agents.kinematic.interface import Poses, UserBody
from agents.kinematic.recurrent.poser import RecurrentPoser
from agents.kinematic.registry import AGENTS
from agents.kinematic.store import save_system
from agents.resolve import shipped_policies, shipped_systems
from docs.figures.comparison_windows import by_frame, part
from questsim.cli import main
from questsim.errors import INTERRUPTED, InputError
from questsim.joint_sensors import readings
from questsim.motion.checks import stature_of
from questsim.motion.library import save_library
from questsim.motion.retarget_back import to_motion
from questsim.pose_metrics import pose_samples
from questsim.sensors import SENSOR_SETS
from questsim.skeleton import JOINTS
from tests.helpers import swaying_clip

MOTION = to_motion(swaying_clip(frames=20))


def saved(agent, folder):
    """An untrained system on disk."""
    torch.manual_seed(0)
    entry = AGENTS[agent]
    config = entry.presets["smoke"]
    module, stage = entry.build(config.spec), next(iter(config.stages))
    bank = MotionBank([MOTION], 3 if agent == "dragposer" else 18)
    entry.task(module, stage, config.stages[stage], bank, 2)
    save_system(folder, module, agent, config.spec, {"trained": [stage]})
    return str(folder)


def test_one_command_scores_all_systems_on_the_same_frames(tmp_path, capsys):
    motions = tmp_path / "motions.npz"
    save_library(motions, [MOTION], [])
    hmd = saved("hmdposer", tmp_path / "hmd")
    out = tmp_path / "scores"
    args = CompareArgs(agents=("ik", hmd), motions=str(motions), out=out, threads=1, windows=True)
    assert compare(args) == 0
    report = json.loads((out / "comparison.json").read_text())
    assert [row["agent"] for row in report["rows"]] == ["recording", "ik", *[hmd] * 6]
    recording = report["rows"].pop(0)["pooled"]
    assert recording["pos_cm"] == pytest.approx(0.0, abs=1e-6)
    assert recording["jitter_100_m_s3"] > 0.0
    ik = report["rows"][0]["pooled"]
    assert ik["pos_cm"] < 1.0 and ik["ee_cm"] < 1.0
    mmac = [row["mmac"] for row in report["rows"]]
    assert mmac[0] is None and mmac[1] > 0.01 and mmac[4] is None  # ik; HMD; HMD, window 40
    assert report["rows"][1]["stream_kib"] > 1.0 and report["rows"][0]["stream_kib"] is None
    assert report["rows"][1]["pooled"]["mpjpe_cm"] > ik["mpjpe_cm"]
    with (out / "comparison.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 16 and float(lines[0]["pos_cm"]) >= 0
    assert "| ik | 6 |" in (out / "comparison.md").read_text()
    assert {file.name for file in out.iterdir()} == set(FILES)
    assert "| ik | 6 |" in capsys.readouterr().out


def test_zero_and_random_torques_are_compared_like_policies(tmp_path):
    motions = tmp_path / "motions.npz"
    save_library(motions, [to_motion(swaying_clip(frames=12))], [])
    agents, out = ("zero", "random"), tmp_path / "scores"
    args = CompareArgs(agents=agents, motions=str(motions), out=out, threads=1)
    assert compare(args) == 0
    report = json.loads((out / "comparison.json").read_text())
    rows = {row["agent"]: row["pooled"] for row in report["rows"]}
    assert {"zero", "random"} <= set(rows)
    assert rows["zero"]["mpjpe_cm"] != rows["random"]["mpjpe_cm"] > 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"agents": ("ik",), "sensors": "7T"}, "unknown sensor set '7T'"),
        ({"agents": ("ik",), "sensors": "H"}, "ik does not support H"),
        (
            {"agents": ("nobody",)},
            "nobody: is not an agent; name .* or .*questsim, .*hmdposer.*zero",
        ),
        ({"agents": ("nobody+physics",)}, "nobody: is not a kinematic system"),
        ({"agents": ("ik",), "starts": ("user",)}, "--starts: does nothing: no agent has physics"),
        ({"agents": ("ik",), "windows": True}, "--windows: does nothing"),
        ({"agents": ("ik",), "noise": ("all", "all")}, "--noise: has a value twice"),
    ],
)
def test_a_comparison_without_what_it_needs_is_refused(options, message, tmp_path):
    with pytest.raises(InputError, match=message):
        compare(CompareArgs(out=tmp_path / "there", **options))
    assert not (tmp_path / "there").exists()


def test_a_comparison_without_agents_is_refused():
    with pytest.raises(InputError, match="the agent's name is empty"):
        evaluate(EvaluateArgs(agent=""))


def test_without_names_all_that_is_shipped_is_compared_once_and_no_agent_that_observes_the_answer():
    found = shipped_agents()
    assert {"ik", "hmdposer", "lgsik", "hmdposer+physics", "questsim"} <= set(found)
    assert not {"tracker", "demo"} & set(found) and len(set(found)) == len(found)


def test_only_scenarios_of_the_sensors_given_are_run():
    planned = plan((), "H+2C")
    assert {"hmdposer", "lgsik", "lgsik+physics", "questsim"} <= set(planned)
    assert not {"ik", "questsim-headset"} & set(planned)
    names = [scenario.name for scenario in planned["hmdposer"].scenarios]
    assert names == ["HMD", "HMD, window 40"]
    assert [scenario.name for scenario in planned["hmdposer+physics"].scenarios] == ["HMD"]


def test_a_tracker_on_a_foot_is_one_wherever_it_is_worn(tmp_path):
    drag = saved("dragposer", tmp_path / "drag")
    planned = plan(("ik", drag), "6T")
    assert [scenario.name for scenario in planned["ik"].scenarios] == ["6"]
    assert "6, 1 iteration" in [scenario.name for scenario in planned[drag].scenarios]
    assert not {"4", "5 no left foot"} & {scenario.name for scenario in planned[drag].scenarios}


def test_end_effectors_are_those_that_carry_a_device(tmp_path):
    (four,) = [s for s in load_system(saved("dragposer", tmp_path)).scenarios if s.name == "4"]
    assert [JOINTS[i] for i in four.ends] == ["head", "left_wrist", "right_wrist"]
    (six,) = load_system("ik").scenarios
    assert {JOINTS[i] for i in six.ends} - {JOINTS[i] for i in four.ends} == {
        "left_toe", "right_toe",
    }  # fmt: skip
    want = np.repeat(MOTION.forward_kinematics()[0][:1], 5, axis=0)
    got = want.copy()
    got[:, JOINTS.index("left_toe"), 2] += 0.05
    samples = [
        pose_samples(got, MOTION.rotations[:5], want, MOTION.rotations[:5], 60.0, s.ends)["ee_cm"]
        for s in (four, six)
    ]
    assert samples[0].max() == 0.0 and samples[1] == pytest.approx(1.0)


def test_a_stopped_comparison_goes_on_and_another_one_is_refused(tmp_path, monkeypatch, capsys):
    motions, out = tmp_path / "motions.npz", tmp_path / "scores"
    short = to_motion(swaying_clip(frames=10))
    save_library(motions, [short, replace(short, name="other")], [])
    args = CompareArgs(agents=("ik",), motions=str(motions), out=out, threads=1)
    with pytest.raises(InputError, match="no comparison that was begun; leave --finished out"):
        compare(replace(args, finished=True))
    assert not out.exists()
    done, real = [], run_module._scored

    def stopped(poses, job):
        if done:
            raise KeyboardInterrupt
        done.append(job)
        return real(poses, job)

    monkeypatch.setattr(run_module, "_scored", stopped)
    assert compare(args) == INTERRUPTED and not (out / "comparison.json").exists()
    with pytest.raises(InputError, match="no row of ik is complete; leave --finished out"):
        compare(replace(args, finished=True))
    assert not (out / "comparison.json").exists()
    capsys.readouterr()
    assert compare(replace(args, agents=(), finished=True)) == 0
    assert "rows that are not complete are left out: 1 of ik" in capsys.readouterr().err
    complete = json.loads((out / "comparison.json").read_text())["rows"]
    assert [row["agent"] for row in complete] == ["recording"]
    with (out / "clips.jsonl").open("a") as file:
        file.write('{"row": "ik: 6", "cl')  # as Ctrl-C leaves it
    again = []

    def again_scored(poses, job):
        again.append(job.motion.name)
        return real(poses, job)

    monkeypatch.setattr(run_module, "_scored", again_scored)
    assert compare(args) == 0 and len(again) == 1
    row = json.loads((out / "comparison.json").read_text())["rows"][1]
    assert row["pooled"]["pos_cm"] < 1.0 and row["std"]["pos_cm"] > 0.0
    with pytest.raises(InputError, match=r"another comparison \(other seed"):
        compare(replace(args, seed=1))
    # Results of another moment at which avatars begin are not taken for today's.
    monkeypatch.setattr("agents.comparison.compare.SETTLED_FRAMES", 0)
    with pytest.raises(InputError, match=r"another comparison \(other settled_frames"):
        compare(args)


def test_sums_of_clips_give_the_mean_deviation_and_interval_of_all_samples():
    rng = np.random.default_rng(0)
    parts = [rng.normal(3.0, 1.0, n) + i for i, n in enumerate((5, 40, *[20] * 10))]
    row = row_of("a", "6", [sums_of({"pos_cm": part}, 60.0) for part in parts], Costs())
    whole = np.concatenate(parts)
    assert row.pooled["pos_cm"] == pytest.approx(whole.mean())
    assert row.equal["pos_cm"] == pytest.approx(np.mean([part.mean() for part in parts]))
    assert row.std["pos_cm"] == pytest.approx(whole.std())
    assert row.low["pos_cm"] < whole.mean() < row.high["pos_cm"]


@pytest.mark.parametrize("noise", NOISES)
def test_noise_changes_what_it_says_and_nothing_else(noise):
    motion = to_motion(swaying_clip(frames=200)).resampled(60.0)
    plain = readings(motion, SENSOR_SETS["H+2C+3IMU"])
    got = noisy(plain, noise, 3)
    assert np.array_equal(noisy(plain, noise, 3).position, got.position)
    off = np.linalg.norm(got.position - plain.position, axis=-1)[:, :3]
    if noise == "white":
        assert (got.position - plain.position)[:, :3].std() == pytest.approx(0.005, rel=0.1)
    elif noise == "mounts":
        assert off.std(axis=0).max() < 1e-9 and 0.0 < off.max() <= 0.03
    elif noise == "latency":
        assert np.array_equal(got.position[5:, :3], plain.position[:-5, :3])
    assert got.present.all() == (noise not in ("dropouts", "all")) and got.present.any(axis=1).all()


def test_a_later_floor_does_not_reach_back_and_a_known_body_is_kept():
    motion = to_motion(swaying_clip(frames=72)).resampled(60.0)
    sunk = motion.root_position.copy()
    sunk[80:, 2] -= 0.2
    a, b = causal_clip(motion), causal_clip(replace(motion, root_position=sunk))
    assert np.allclose(a.qpos[:46], b.qpos[:46]) and not np.allclose(a.qpos[60:], b.qpos[60:])
    offsets = np.broadcast_to(motion.offsets, (len(motion), 22, 3))
    poses = Poses(motion.root_position, motion.rotations, offsets)
    assert body_of(poses, motion) is motion.offsets
    grown = replace(poses, offsets=offsets * 1.0372)
    assert 100.0 * stature_of(body_of(grown, motion)) == pytest.approx(
        round(100.0 * stature_of(motion.offsets) * 1.0372)
    )


def test_two_processes_give_the_figures_of_one(tmp_path):
    motions = tmp_path / "motions.npz"
    save_library(motions, [MOTION, replace(MOTION, name="other")], [])
    hmd = saved("hmdposer", tmp_path / "hmd")
    found = []
    for threads in (1, 2):
        out = tmp_path / f"scores{threads}"
        args = CompareArgs(
            agents=(hmd,), sensors="H+2C", motions=str(motions), out=out,
            threads=threads,
        )  # fmt: skip
        assert compare(args) == 0
        rows = json.loads((out / "comparison.json").read_text())["rows"]
        found.append([(row["scenario"], row["pooled"]) for row in rows])
    assert found[0] == found[1] and len(found[0]) == 2


def test_dragposer_is_compared_in_every_scenario_of_its_table(tmp_path):
    names = [s.name for s in load_system(saved("dragposer", tmp_path / "drag")).scenarios]
    assert names[:5] == ["3 head+hands", "3 hip+hands", "4", "5 no left foot", "6"]
    assert names[-2:] == ["faulty 0.5 %", "faulty 1 %"]


def test_rows_with_and_without_predictor_are_drawn_over_time(tmp_path):
    def scored(scenario, error_cm):
        curve = [[error_cm * 6, 6.0]] * 10 + [[0.0, 0.0]] * (CURVE_BINS - 10)
        return Row("dragposer", scenario, 1, {}, {}, None), [Summary({}, curve=curve)]

    rows = [scored("4", 2.0), scored("4, no predictor", 5.0), scored("6", 1.0)]
    assert predictor_pairs(rows, [0]) == [(rows[1], rows[0])]
    assert not predictor_pairs(rows[:1], [0])
    # A row with all clips is reduced to those of the other.
    more = (rows[0][0], [*scored("4", 9.0)[1], *rows[0][1]])
    assert predictor_pairs([more, rows[1]], [1]) == [(rows[1], rows[0])]
    curve = _over_time(rows[1][1])
    assert curve is not None
    times, errors = curve
    assert np.allclose(times, 0.1 * np.arange(10) + 0.05)
    assert np.allclose(errors, 5.0)
    predictor_over_time(predictor_pairs(rows, [0]), tmp_path / "predictor.png")
    assert (tmp_path / "predictor.png").stat().st_size > 1000


def test_the_window_protocol_forgets_what_is_older_than_the_window(tmp_path):
    system = load_system(saved("lgsik", tmp_path / "lgsik"))
    assert isinstance(system, RecurrentPoser)
    motion = MOTION.resampled(60.0)
    seen, body = readings(motion, SENSOR_SETS["H+2C"]), UserBody.of(motion)
    whole = system.predict(seen, body)
    windowed = system.predict_windows(seen, body, 8)
    assert len(windowed) == len(whole) > 8
    alone = system.predict(part(seen, len(seen) - 8, 8), body)
    assert np.allclose(windowed.rotations[-1], alone.rotations[-1], atol=1e-5)
    assert np.allclose(windowed.root_position[-1], alone.root_position[-1], atol=1e-5)
    assert np.allclose(windowed.rotations[:8], whole.rotations[:8], atol=1e-5)
    assert not np.allclose(windowed.rotations[-1], whole.rotations[-1], atol=1e-5)


def test_errors_in_a_window_are_those_of_its_own_frames():
    motion = to_motion(swaying_clip(frames=50)).resampled(60.0)

    class Growing:
        """Knows the pose and makes the body larger by one percent a frame of the window."""

        def predict(self, sequence, body):
            at = np.round(sequence.time_s * 60.0).astype(int)
            scale = 1.0 + 0.01 * np.arange(len(at))
            offsets = body.offsets * scale[:, None, None]
            return Poses(motion.root_position[at], motion.rotations[at], offsets)

    scenario = load_system("ik").scenarios[0]
    errors, count = by_frame(Growing(), scenario, [motion])  # type: ignore[arg-type]
    joints = motion.forward_kinematics()[0]
    away = np.linalg.norm(joints - joints[:, JOINTS.index("head")][:, None], axis=-1).mean(axis=1)
    starts = range(0, len(motion) - 39, 20)
    assert count == len(starts) >= 2 and errors[0] == pytest.approx(0.0, abs=1e-6)
    want = [np.mean([away[start + k] for start in starts]) * k for k in range(40)]
    assert errors == pytest.approx(np.array(want), abs=1e-6)


def test_a_faulty_tracker_is_silent_for_a_hundred_frames_and_one_always_reports():
    motion = to_motion(swaying_clip(frames=300)).resampled(60.0)
    seen = faulty(readings(motion, SENSOR_SETS["6T"]), 0.05, 0)
    silent = ~seen.present
    assert silent.any() and not silent.all(axis=1).any()
    device = int(silent.any(axis=0).argmax())
    first = int(silent[:, device].argmax())
    assert silent[first : first + 100, device].all()
    assert np.array_equal(faulty(seen, 0.0, 0).present, seen.present)


def test_a_figure_with_nothing_to_average_is_a_dash(tmp_path):
    row = Row("a", "6", 10, {"pos_cm": None}, {"pos_cm": None}, 1.0)
    assert "| a | 6 | - | 10 | - | 1.00 |" in table(
        [row], ["pos_cm", "parameters", "mmac", "ms"], "equal"
    )


def test_the_main_tables_have_intervals_where_there_are_more_than_ten_clips():
    rng = np.random.default_rng(1)
    clips = [sums_of({"pos_cm": rng.normal(5.0, 1.0, 40)}, 60.0) for _ in range(11)]
    row, few = row_of("a", "6", clips, Costs()), row_of("b", "6", clips[:10], Costs())
    assert row.fewer == {} and row_of("a", "6", clips, Costs(), None, clips[:10]).fewer == {
        "pos_cm": pytest.approx(few.pooled["pos_cm"])
    }
    lines = table([row, few], ["pos_cm"], ends=True).splitlines()
    low, high = row.low["pos_cm"], row.high["pos_cm"]
    assert low < row.pooled["pos_cm"] < high  # type: ignore[operator]
    assert lines[2] == f"| a | 6 | 11 | {row.pooled['pos_cm']:.2f} ({low:.2f} to {high:.2f}) |"
    assert lines[3] == f"| b | 6 | 10 | {few.pooled['pos_cm']:.2f} |"


def test_figures_tell_physics_and_policies_from_poses_and_show_what_is_missing(tmp_path):
    plain: dict[str, float | None] = {"foot_skate_cm_s": 4.0}
    simulated: dict[str, float | None] = {"foot_skate_cm_s": 1.0, "success_percent": 90.0}
    rows = [
        Row("ik", "6", 0, plain, plain, 1.0),
        Row("ik+physics", "6, no physics", 0, plain, plain, 1.0),
        Row("ik+physics", "6", 10, simulated, simulated, 1.0),
        Row("questsim", "HMD", 10, simulated, simulated, 1.0),
    ]
    kinds = ["kinematic", "kinematic", "with physics behind it", "policy"]
    assert [kind_of(row) for row in rows] == kinds
    for name, plot in FIGURES.items():
        plot(rows, tmp_path / name)
    with Image.open(tmp_path / "plausibility.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    bars = [int((pixels == to_rgb(KINDS[kind])).all(axis=1).sum()) for kind in KINDS]
    # Two rows of 4 against one of 1 each: eight times the ink.
    assert bars[0] > 5 * bars[1] > 0 and bars[1] == pytest.approx(bars[2], rel=0.05)


def to_rgb(colour):
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])


def test_the_list_of_agents_has_every_agent_and_preset(capsys):
    assert main(["agents", "--json"]) == 0
    entries = json.loads(capsys.readouterr().out)
    found = {(entry["agent"], entry["preset"]) for entry in entries}
    assert {(name, preset) for name, e in AGENTS.items() for preset in e.presets} < found
    assert {*shipped_systems(), *shipped_policies()} <= {name for name, _ in found}
    hmd = next(e for e in entries if (e["agent"], e["preset"]) == ("hmdposer", "paper"))
    assert hmd["parameters"] == 17_444_484
    assert hmd["sensors"] == ["H+2C", "H+2C+2IMU", "H+2C+3IMU"]
    assert {"licence", "weights", "title"} < set(hmd)
    demo = next(e for e in entries if e["agent"] == "demo")
    assert demo["weights"] and demo["licence"] == "MIT"


@pytest.mark.parametrize(("agent", "published"), [("hmdposer", 72.6), ("lgsik", 7.2)])
def test_multiply_accumulates_of_the_papers_networks_are_the_published_ones(agent, published):
    entry = AGENTS[agent]
    module = entry.build(entry.presets["paper"].spec)
    module.get_buffer("template").copy_(torch.as_tensor(MOTION.offsets))
    system = entry.system(module, agent, ["network"], {})
    seen = readings(MOTION.resampled(60.0), SENSOR_SETS["H+2C+3IMU"])
    assert mmac_a_frame(system, seen, UserBody.of(MOTION)) == pytest.approx(published, rel=0.01)


def test_the_memory_of_a_stream_counts_what_it_keeps_and_does_not_grow(tmp_path):
    system = load_system(saved("dragposer", tmp_path / "drag"), iterations=1)
    seen = readings(MOTION.resampled(60.0), SENSOR_SETS["6T"])
    system.reset(UserBody.of(MOTION), "6T")
    sizes = []
    for frame in range(9):
        system.step(seen[frame])
        sizes.append(stream_kib(system))
    assert sizes[-1] == sizes[0] > 0
    before = stream_kib(system)
    kept = torch.zeros(2, 256)  # 2 KiB
    system._more = [kept, kept[:1], {"a": np.zeros(128)}]  # type: ignore[attr-defined]
    assert stream_kib(system) == before + 3.0


def test_a_block_of_poses_is_retargeted_like_one_pose_after_the_other():
    motion = to_motion(swaying_clip(frames=60)).resampled(60.0)
    floor = np.linspace(0.0, 0.1, len(motion))[:, None] * [0.0, 0.0, 1.0]
    sinking = replace(motion, root_position=motion.root_position - floor)
    together, one = causal_clip(sinking), causal_clip(sinking, at_once=1)
    assert np.allclose(together.qpos, one.qpos, atol=1e-12)
    assert not np.allclose(together.qpos, causal_clip(motion).qpos, atol=1e-4)


def test_sequences_solved_together_have_the_poses_of_their_streams(tmp_path):
    system = load_system(saved("dragposer", tmp_path / "drag"), predictor=False)
    motions = [MOTION, to_motion(swaying_clip(frames=14))]
    for sensors in ("6T", "3T"):
        seen = [readings(m.resampled(60.0), SENSOR_SETS[sensors]) for m in motions]
        seen = [faulty(sequence, 0.1, 2) for sequence in seen]
        bodies = [UserBody.of(motion) for motion in motions]
        together = system.predict_many(seen, bodies)
        for sequence, body, poses in zip(seen, bodies, together, strict=True):
            alone = system.predict(sequence, body)
            assert len(poses) == len(alone) == len(sequence)
            assert np.allclose(poses.rotations, alone.rotations, atol=1e-9)
            assert np.allclose(poses.root_position, alone.root_position, atol=1e-9)


def test_other_weights_or_more_agents_keep_the_results_of_the_others(tmp_path):
    agents, row = {"a": "1", "b": "1"}, sums_of({"pos_cm": np.ones(3)}, 60.0)
    with Record(tmp_path, {"seed": 0}, agents) as record:
        record.add("a: 6", "clip", row)
        record.add("b: 6", "clip", row)
    with Record(tmp_path, {"seed": 0}, {"a": "2", "b": "1", "c": "1"}) as record:
        assert record.missing(["a: 6"], ["clip"]) == [0] == record.missing(["c: 6"], ["clip"])
        assert record.missing(["b: 6"], ["clip"]) == []
        record.add("a: 6", "clip", row)
    with Record(tmp_path, {"seed": 0}, {"a": "2"}) as record:
        assert record.missing(["a: 6"], ["clip"]) == []


def test_fewer_clips_are_for_all_rows_but_streams_of_exact_signals(tmp_path):
    motions = tmp_path / "motions.npz"
    save_library(motions, [MOTION, replace(MOTION, name="other")], [])
    out = tmp_path / "scores"
    args = CompareArgs(
        agents=("ik",), motions=str(motions), out=out, threads=1, fewer_clips=1, noise=("white",)
    )
    assert compare(args) == 0
    rows = json.loads((out / "comparison.json").read_text())["rows"]
    assert [(row["scenario"], row["clips"]) for row in rows[1:]] == [
        ("6", 2), ("6, noise: white", 1),
    ]  # fmt: skip
    assert [bool(row["fewer"]) for row in rows] == [True, True, False]
    assert "| ik | 6 | 2 |" in (out / "comparison.md").read_text()


def test_rows_of_fewer_clips_can_be_chosen(tmp_path):
    motions = tmp_path / "motions.npz"
    save_library(motions, [MOTION, replace(MOTION, name="other")], [])
    args = CompareArgs(
        agents=("ik", "ik+physics"), motions=str(motions), out=tmp_path / "scores", threads=1,
        fewer_clips=1, fewer_rows=("noise", "starts"), noise=("white",),
        starts=("user", "standing"),
    )  # fmt: skip
    assert compare(args) == 0
    found = json.loads((args.out / "comparison.json").read_text())
    assert {(row["agent"], row["scenario"]): row["clips"] for row in found["rows"][1:]} == {
        ("ik", "6"): 2, ("ik", "6, noise: white"): 1,
        ("ik+physics", "6, no physics"): 2, ("ik+physics", "6, from the user's state"): 2,
        ("ik+physics", "6, from standing"): 1,
        ("ik+physics", "6, noise: white, no physics"): 1,
        ("ik+physics", "6, noise: white, from the user's state"): 1,
    }  # fmt: skip
    assert found["context"]["fewer_rows"] == ["noise", "starts"]


def test_rows_of_fewer_clips_need_their_number(tmp_path):
    with pytest.raises(InputError, match="--fewer-rows"):
        compare(CompareArgs(agents=("ik",), out=tmp_path / "scores", fewer_rows=("noise",)))
    assert not (tmp_path / "scores").exists()


def test_rows_are_named_by_their_condition_and_read_again():
    for start in get_args(Start):
        assert condition_of(row_name("6", None, start)) == ("6", start)
    assert row_name("6", "white", "standing") == "6, noise: white, from standing"
    rows = [
        Row("ik+physics", row_name(scenario, None, start), 0, {}, {}, None)
        for scenario in ("4", "6")
        for start in ("standing", "user")
    ]
    ((row, _),) = compared([(row, []) for row in rows])
    assert row.scenario == "6, from standing"
    noisy_row = Row("ik+physics", row_name("6", "white", "standing"), 0, {}, {}, None)
    assert [r.scenario for r in first_starts([noisy_row, *rows])] == [
        "4, from standing",
        "6, from standing",
    ]
