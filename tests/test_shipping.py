"""Shipping a policy: what is copied, what its card says, and what is refused."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from rollouts import moving_clip, rollout

from agents.agent import Needs
from agents.kinematic.store import load_system, read_system_card
from agents.licence import licence_of, strictest
from agents.policy.checkpoint import CARD_FILE, CRITIC_FILE, load_policy, save_policy
from agents.policy.policy_agent import PolicyAgent, Tracker, new_policy
from agents.policy.spec import TRACKER_BLOCKS, Layout, PolicySpec
from agents.resolve import SHIPPED
from agents.run_folder import note_resume, read_run, start_run
from agents.shipping import ship as shipping
from agents.shipping.provenance import StagePart, _joined, _renamed, options_of
from agents.shipping.ship import ShipArgs, check_name, ship
from agents.training.options import TrainArgs
from agents.training.presets import PRESETS
from envs.config import EnvConfig
from envs.layout import observation_layout
from questsim import cli
from questsim.errors import InputError
from questsim.metrics import evaluate

BANDAI = "bandai-namco-2:train"


def data(motions: str = "synthetic", **licences: int) -> dict:
    licences = licences or {"MIT": 40}
    return {
        "motions": motions, "clips": sum(licences.values()), "seconds": 1800.0,
        "licences": licences, "sha256": motions,
    }  # fmt: skip


def new_run(folder: Path, record: dict, **options) -> Path:
    args = TrainArgs(out=folder, **{"motions": record["motions"]} | options)
    start_run(folder, args, PRESETS[args.preset], record)
    return folder


def add_stage(run: Path, stage: str, record: dict, steps: int, minutes: float, **needs) -> None:
    """A stage that went on for half as long again after its best policy."""
    torch.manual_seed(0)
    teacher = stage == "teacher"
    blocks = {"actor_blocks": TRACKER_BLOCKS, "reference_head": True} if teacher else {}
    config = EnvConfig(privileged=teacher, **needs)
    spec = PolicySpec(critic_blocks=(), hidden=(16, 8), activation="elu", **blocks)
    layout = Layout.of(observation_layout(config)).within(spec.actor_blocks)
    policy = new_policy(spec, layout)
    for which, factor in (("best", 1.0), ("last", 1.5)):
        training = {
            "preset": "cpu", "seed": 7, **record, "stage": stage,
            "steps": int(steps * factor), "minutes": minutes * factor,
        }  # fmt: skip
        save_policy(run / stage / which, policy, Needs(privileged=teacher, **needs), training)


@pytest.fixture
def run(tmp_path) -> Path:
    """A teacher and its student, on motions that allow no commercial use."""
    record = data(BANDAI, **{"CC-BY-NC-4.0": 100})
    folder = new_run(tmp_path / "private" / "mine", record, seed=7, mirrored=True)
    add_stage(folder, "teacher", record, 12_000_000, 120.0)
    add_stage(folder, "student", record, 1_600_000, 30.0)
    return folder


def metrics_of(policy: Path, folder: Path, name: str = "metrics", **config) -> Path:
    """What an evaluation of a policy writes."""
    clips = [moving_clip(seed=0, kind="walk"), moving_clip(seed=1, kind="run")]
    context = {
        "training": load_policy(policy).card["training"],
        "data": {"motions": "bandai-namco-2:test"},
        "config": {"heights": None} | config,
    }
    rollouts = [rollout(clips[0]), rollout(clips[1], frames=8, fell=True)]
    path = folder / f"{name}.json"
    path.write_text(json.dumps(evaluate(rollouts, context)))
    return path


def card_of(folder: Path) -> str:
    return (folder / "README.md").read_text()


def test_best_policy_is_copied_and_loads_by_name(run, tmp_path, monkeypatch):
    shipped = tmp_path / "weights"
    assert ship(ShipArgs(run, "walker", into=shipped)) == 0
    assert {path.name for path in (shipped / "walker").iterdir()} == {
        "README.md", "policy.safetensors", "policy.yaml",
    }  # fmt: skip
    monkeypatch.setattr("agents.resolve.SHIPPED", shipped)
    from agents.loading import load_agent

    agent, trained = load_agent("walker"), load_policy(run / "student" / "best")
    assert isinstance(agent, PolicyAgent)
    obs = np.random.default_rng(0).normal(size=(2, 475)).astype(np.float32)
    np.testing.assert_array_equal(agent.act(obs), trained.act(obs))


def test_teacher_is_shipped_as_a_tracker(run, tmp_path):
    ship(ShipArgs(run / "teacher", "tracker", into=tmp_path))
    assert isinstance(load_policy(tmp_path / "tracker"), Tracker)
    card = card_of(tmp_path / "tracker")
    assert "any full-body reference" in card
    assert "headset" not in card
    assert "student" not in card.partition("## Figures")[0]


def test_the_card_has_data_licence_commands_seed_and_hours(run, tmp_path):
    ship(ShipArgs(run, "walker", into=tmp_path))
    card = card_of(tmp_path / "walker")
    assert "| licence | CC-BY-NC-4.0 |" in card
    assert "**no commercial use**" in card
    assert "Copyright Bandai Namco Research Inc." in card
    assert f"`{BANDAI}`: 100 clips, 30 min" in card
    assert "teacher 18.0 M steps, 3.0 h; student 2.4 M steps, 45 min; 3.8 h in all" in card
    assert "| seed | 7 |" in card
    options = f"--motions {BANDAI} --preset cpu --mirrored --seed 7"
    assert (
        f"python train.py {options} --stage teacher --minutes 180 --out runs/NAME\n"
        f"python train.py {options} --stage student --minutes 45 --out runs/NAME --resume\n"
    ) in card
    assert "6 future frames, a delay of 170 ms" in card
    assert str(tmp_path) not in card
    assert "It has not been evaluated." in card


def test_commands_of_a_card_are_ones_that_train_takes(run, tmp_path):
    import shlex

    import tyro

    ship(ShipArgs(run, "walker", into=tmp_path))
    training = yaml.safe_load((tmp_path / "walker" / "policy.yaml").read_text())["training"]
    for line in training["commands"]:
        args = tyro.cli(TrainArgs, args=shlex.split(line)[2:])
        assert (args.motions, args.seed, args.mirrored) == (BANDAI, 7, True)


def test_card_has_the_figures_of_each_evaluation(run, tmp_path):
    best = run / "student" / "best"
    own = metrics_of(best, tmp_path)
    tall = metrics_of(best, tmp_path, "tall", heights=[1.95, 1.95])
    ship(ShipArgs(run, "walker", (own, tall), tmp_path))
    card = card_of(tmp_path / "walker")
    assert "### bandai-namco-2:test, 2 clips, the clips' own statures" in card
    assert "### bandai-namco-2:test, 2 clips, 1.95 m" in card
    assert "| success (%) | 50.0 | 100.0 |" in card
    assert "| walk | 1 | 100.0 | 0.00 |" in card
    assert "| run | 1 | 0.0 |" in card
    assert "real-time" not in card


def test_metrics_of_the_shipped_policy_are_its_own(run, tmp_path):
    ship(ShipArgs(run, "walker", into=tmp_path))
    again = metrics_of(tmp_path / "walker", tmp_path)
    assert ship(ShipArgs(run, "walker", (again,), tmp_path)) == 0
    assert "| success (%) | 50.0 | 100.0 |" in card_of(tmp_path / "walker")


def test_metrics_of_another_policy_are_refused_and_the_old_one_stays(run, tmp_path):
    ship(ShipArgs(run, "walker", into=tmp_path))
    before = card_of(tmp_path / "walker")
    other = metrics_of(run / "student" / "last", tmp_path)
    with pytest.raises(InputError, match="another policy: its steps is 2400000, not 1600000"):
        ship(ShipArgs(run, "walker", (other,), tmp_path))
    assert card_of(tmp_path / "walker") == before


@pytest.mark.parametrize("content", ["no json", "[]", '{"schema": "x"}'])
def test_a_file_that_is_not_a_report_is_refused(run, tmp_path, content):
    path = tmp_path / "metrics.json"
    path.write_text(content)
    with pytest.raises(InputError, match="is not a report"):
        ship(ShipArgs(run, "walker", (path,), tmp_path / "weights"))
    assert not (tmp_path / "weights").exists()


def test_student_of_another_runs_teacher_has_both_licences_and_commands(run, tmp_path):
    record = data()
    other = new_run(tmp_path / "headset", record, stage="student", teacher=run, sensors="H")
    add_stage(other, "student", record, 1_000_000, 20.0, sensors="H")
    ship(ShipArgs(other, "headset", into=tmp_path))
    card = card_of(tmp_path / "headset")
    assert "| licence | CC-BY-NC-4.0 |" in card
    assert f"earlier stages on `{BANDAI}`" in card
    assert "--stage teacher --minutes 180 --out runs/TEACHER\n" in card
    assert (
        "--sensors H --stage student --minutes 30 --out runs/NAME --teacher runs/TEACHER\n"
    ) in card


def test_a_student_that_a_resume_gave_another_teacher_names_both_and_their_licences(run, tmp_path):
    record, runs = data(), tmp_path / "others" / "mine"  # a folder of the same name as ``run``
    add_stage(new_run(runs, record), "teacher", record, 2_000_000, 20.0)
    options = {"stage": "student", "motions": "synthetic", "out": tmp_path / "s"}
    student = new_run(tmp_path / "s", record, stage="student", teacher=run)
    note_resume(student, TrainArgs(teacher=runs, resume=True, **options), PRESETS["cpu"])
    add_stage(student, "student", record, 1_000_000, 20.0)
    ship(ShipArgs(student, "taught", into=tmp_path))
    card = card_of(tmp_path / "taught")
    assert "| licence | CC-BY-NC-4.0 |" in card
    assert "student 1.5 M steps, 30 min, first taught by `runs/mine`" in card
    assert "--minutes 180 --out runs/mine\n" in card  # of the first teacher
    assert "--stage student --minutes 30 --out runs/NAME --teacher runs/TEACHER\n" in card


def test_student_of_a_shipped_teacher_repeats_how_that_was_trained(run, tmp_path, monkeypatch):
    weights = tmp_path / "weights"
    ship(ShipArgs(run / "teacher", "tracker", into=weights))
    monkeypatch.setattr("agents.resolve.SHIPPED", weights)
    record = data()
    other = new_run(tmp_path / "headset", record, stage="student", teacher="tracker", sensors="H")
    add_stage(other, "student", record, 1_000_000, 20.0, sensors="H")
    ship(ShipArgs(other, "headset", into=weights))
    training = load_policy(weights / "headset").card["training"]
    assert training["licence"] == "CC-BY-NC-4.0"
    assert [stage["stage"] for stage in training["stages"]] == ["teacher", "student"]
    taught, student = training["commands"]
    assert "--stage teacher --minutes 180 --out runs/tracker" in taught
    assert student.endswith("--out runs/NAME --teacher runs/tracker")
    with pytest.raises(InputError, match="headset: is a shipped policy, not one of a run; name"):
        ship(ShipArgs(weights / "headset", "again", into=weights))


def test_a_shipped_teacher_keeps_its_critic(run, tmp_path):
    best = run / "teacher" / "best"
    (best / CRITIC_FILE).write_bytes(b"values")
    ship(ShipArgs(run / "teacher", "tracker", into=tmp_path))
    assert (tmp_path / "tracker" / CRITIC_FILE).read_bytes() == b"values"


def test_policy_of_our_own_motions_is_under_our_licence(tmp_path):
    record = data()
    run = new_run(tmp_path / "demo", record)
    add_stage(run, "teacher", record, 1_000_000, 20.0)
    add_stage(run, "student", record, 1_000_000, 20.0, future_frames=0)
    ship(ShipArgs(run, "demo", into=tmp_path / "weights"))
    card = card_of(tmp_path / "weights" / "demo")
    assert "| licence | MIT |" in card
    assert "commercial" not in card
    assert "the current frame of headset, left controller, right controller" in card
    assert "future frames" not in card


def test_policy_from_motions_without_a_licence_is_refused(tmp_path):
    record = data("mine.npz", **{"MIT": 1, "not stated": 2})
    run = new_run(tmp_path / "mine", record)
    add_stage(run, "teacher", record, 1000, 1.0)
    with pytest.raises(InputError, match="no stated licence"):
        ship(ShipArgs(run, "mine", into=tmp_path / "weights"))
    assert not (tmp_path / "weights").exists()


def test_large_weights_are_refused(run, tmp_path, monkeypatch):
    monkeypatch.setattr(shipping, "MAX_BYTES", 1000)
    with pytest.raises(InputError, match="more than 10 MB"):
        ship(ShipArgs(run, "walker", into=tmp_path / "weights"))
    assert not (tmp_path / "weights").exists()


def test_policy_outside_a_run_is_refused(run, tmp_path):
    (run / "run.yaml").unlink()
    with pytest.raises(InputError, match="not inside a run"):
        ship(ShipArgs(run, "walker", into=tmp_path / "weights"))


@pytest.mark.parametrize("name", ["zero", "random", "../x", "A", "", "-x", "a/b"])
def test_an_invalid_name_is_refused(name):
    with pytest.raises(InputError, match="is not a valid name"):
        check_name(name)


def test_command_line_ships(run, tmp_path, capsys):
    words = ["ship", "--run", str(run), "--name", "demo", "--into", str(tmp_path / "weights")]
    assert cli.main(words) == 0
    assert "CC-BY-NC-4.0" in capsys.readouterr().out


def test_licence_of_weights_is_the_strictest_of_its_motions():
    assert strictest(["MIT", "MIT"]) == "MIT"
    assert strictest(["MIT", "CC-BY-NC-4.0"]) == "CC-BY-NC-4.0"
    assert strictest(["CC-BY-4.0", "MIT", "CC-BY-NC-4.0"]) == "CC-BY-4.0 AND CC-BY-NC-4.0"
    assert strictest(["MIT", "not stated"]) == "not stated"
    mixed = ["CC-BY-NC-4.0", "CC-BY-NC-4.0 AND LicenseRef-CMU-MoCap", "LicenseRef-CMU-MoCap"]
    assert strictest(mixed) == "CC-BY-NC-4.0 AND LicenseRef-CMU-MoCap"
    assert strictest([]) == "not stated"
    assert licence_of({"licence": "CC-BY-NC-4.0", "licences": {"MIT": 1}}) == "CC-BY-NC-4.0"


def test_shipped_agents_are_small_and_have_cards_and_licences():
    folders = [path for path in SHIPPED.glob("*") if path.is_dir()]
    for folder in folders:
        check_name(folder.name)
        if (folder / CARD_FILE).exists():
            card = load_policy(folder).card
        else:
            load_system(folder.name)
            card = read_system_card(folder)
        assert licence_of(card["training"]) in card_of(folder)
        assert all(path.stat().st_size < shipping.MAX_BYTES for path in folder.iterdir())


def test_a_common_teacher_of_two_shipped_policies_is_listed_once_by_one_name():
    def part(stage: str, command: str) -> StagePart:
        return StagePart(Path("shipped"), {"stage": stage, "motions": "m"}, 8, 1.0, command)

    taught = [part("teacher", "python train.py --out runs/tracker")]
    both = [
        part("teacher", "python train.py --out runs/student-teacher"),
        part("student", "python train.py --out runs/student --teacher runs/student-teacher"),
    ]
    lines = [p.command for p in _joined(taught, both)]
    assert lines == [
        "python train.py --out runs/tracker",
        "python train.py --out runs/student --teacher runs/tracker",
    ]


def test_a_training_is_recognised_under_other_names_of_its_files_and_run():
    def part(command: str, minutes: float = 16.53) -> StagePart:
        about = {"stage": "teacher", "motions": command.split()[3]}
        return StagePart(Path("shipped"), about, 2_000_000, minutes, command)

    line = "python train.py --motions {},synthetic --seed {} --out {} --start {}"
    one = part(line.format("docs/mixtures/wide.toml:train", 0, "runs/a", "runs/t"))
    same = part(line.format("runs/wide.toml:train", 0, "runs/b", "runs/t-2"))
    seed = part(line.format("docs/mixtures/wide.toml:train", 1, "runs/c", "runs/t"))
    longer = part(one.command or "", 16.6)
    more = part(line.format("runs/wide.toml:train,runs/x.npz", 0, "runs/d", "runs/t"))
    assert _joined([one], [same]) == [one]
    for other in (seed, longer, more):
        assert len(_joined([one], [other])) == 2


def test_a_teacher_known_by_its_run_and_by_a_card_is_listed_once(run, tmp_path, monkeypatch):
    """Its hours counted twice."""
    weights, record = tmp_path / "weights", data()
    ship(ShipArgs(run / "teacher", "tracker", into=weights))
    monkeypatch.setattr("agents.resolve.SHIPPED", weights)
    first = new_run(tmp_path / "first", record, stage="student", teacher=run)
    add_stage(first, "student", record, 1_000_000, 20.0)
    options = {"stage": "student", "teacher": "tracker", "start": first}
    second = new_run(tmp_path / "second", record, **options)
    add_stage(second, "student", record, 2_000_000, 40.0)
    ship(ShipArgs(second, "pupil", into=weights))
    training = load_policy(weights / "pupil").card["training"]
    assert [stage["minutes"] for stage in training["stages"]] == [180.0, 30.0, 60.0]
    taught, start, last = (line.split() for line in training["commands"])
    teacher = taught[taught.index("--out") + 1]
    assert start[start.index("--teacher") + 1] == last[last.index("--teacher") + 1] == teacher
    assert last[last.index("--start") + 1] == start[start.index("--out") + 1]


def test_a_run_that_gets_another_name_has_it_as_a_specialist_too() -> None:
    def part(stage: str, command: str) -> StagePart:
        return StagePart(Path("shipped"), {"stage": stage, "motions": "m"}, 8, 1.0, command)

    student = "python train.py --out runs/student --specialists 'runs/b:side-*+kick' runs/b"
    both = [part("teacher", "python train.py --out runs/b"), part("student", student)]
    lines = [p.command for p in _joined([part("teacher", "python train.py --out runs/a")], both)]
    assert lines[1] == student.replace("runs/b", "runs/a")


def test_a_drive_is_not_the_run_of_a_specialist() -> None:
    command = r"python train.py --specialists 'C:\runs\b:side-*' 'C:\runs\b'"
    assert shlex.split(_renamed(command, {"C:\\runs\\b": "runs/a", "C": "runs/c"})) == [
        "python", "train.py", "--specialists", "runs/a:side-*", "runs/a",
    ]  # fmt: skip


def test_no_shipped_policy_lists_a_training_twice_or_needs_one_that_is_not_listed() -> None:
    for folder in (path for path in SHIPPED.glob("*") if (path / CARD_FILE).exists()):
        training = load_policy(folder).card["training"]
        found = [(each["stage"], each["steps"], each["minutes"]) for each in training["stages"]]
        assert len(found) == len(set(found)), folder.name
        runs: set[str] = set()
        for line in training["commands"]:
            words = shlex.split(line)
            runs.add(words[words.index("--out") + 1])
            needed = {words[words.index(o) + 1] for o in ("--teacher", "--start") if o in words}
            if "--specialists" in words:
                first = words.index("--specialists") + 1
                needed |= {word.partition(":")[0] for word in words[first:]}
            # The run from which ``demo`` started was not kept.
            assert needed <= runs or folder.name == "demo", f"{folder.name}: {line}"


def test_a_card_calls_files_as_it_is_told(run, tmp_path):
    record = read_run(run)
    where = str(tmp_path / "mine.npz")
    record["args"]["motions"] = where
    (run / "run.yaml").write_text(yaml.safe_dump(record))
    into = tmp_path / "weights"
    ship(ShipArgs(run, "walker", files=(f"{where}=docs/mixtures/mine.npz",), into=into))
    text = (into / "walker" / "README.md").read_text()
    assert "--motions docs/mixtures/mine.npz " in text and "runs/mine" not in text
    before = {path: path.read_bytes() for path in (into / "walker").iterdir()}
    for value, says in (("mine.npz", "is not FILE=NAME"), ("other.npz=a", "is no file of")):
        with pytest.raises(InputError, match=says):
            ship(ShipArgs(run, "walker", files=(value,), into=into))
    assert before == {path: path.read_bytes() for path in (into / "walker").iterdir()}


def test_cards_name_no_folder_of_the_machine_of_the_training():
    words = options_of({"motions": "/home/me/a.npz,synthetic", "validation": "/home/me/val.npz"})
    assert words == ["--motions", "runs/a.npz,synthetic", "--validation", "runs/val.npz"]
    both = options_of({"motions": "/home/me/a.npz,/home/you/a.npz,/home/me/a.npz:train"})
    assert both == ["--motions", "runs/a.npz,runs/a-2.npz,runs/a.npz:train"]
    texts = [path for path in SHIPPED.rglob("*") if path.suffix in (".md", ".yaml")]
    assert texts and not [
        path for path in texts if re.search(r"(^|[ ,='\"])/\w+/", path.read_text(), re.M)
    ]
