"""Training of the kinematic systems: errors fall, runs are recorded, resumed to the bit."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from agents import precision
from agents.comparison.compare import compare
from agents.comparison.options import CompareArgs
from agents.kinematic import load_system
from agents.kinematic.data import MotionBank, motions_record
from agents.kinematic.fit import Fit
from agents.kinematic.interface import UserBody
from agents.kinematic.learning import rate_at
from agents.kinematic.options import TrainSystemArgs
from agents.kinematic.recurrent.features import HEAD
from agents.kinematic.registry import AGENTS
from agents.kinematic.sparseposer.networks import SparsePoserModule
from agents.kinematic.sparseposer.training import measure_normalisers
from agents.kinematic.store import find_system, load_module, read_system_card, save_system
from agents.kinematic.team import Nobody, Team
from agents.kinematic.training import _budget, train_system
from agents.run_folder import read_run
from agents.shipping.ship import ShipArgs, ship
from agents.shipping.system_card import system_provenance
from agents.training.monitor import Display
from agents.training.stage import Budget, Stopper
from questsim.errors import InputError
from questsim.joint_sensors import readings
from questsim.motion.library import save_library
from questsim.motion.retarget_back import to_motion
from questsim.sensors import SENSOR_SETS
from tests.helpers import swaying_clip

MOTION = to_motion(swaying_clip(frames=90))
STEPS = 24
SETS = {
    "avatarposer": "H+2C", "hmdposer": "H+2C", "lgsik": "H+2C", "sparseposer": "6T",
    "dragposer": "6T",
}  # fmt: skip


@pytest.fixture
def library(tmp_path):
    path = tmp_path / "motions.npz"
    save_library(path, [MOTION], [])
    return str(path)


def save_library_of(motion, path):
    save_library(path, [motion], [])
    return str(path)


def arguments(agent, library, out, **more):
    options = {"preset": "smoke", "threads": 1, "steps": STEPS} | more
    return TrainSystemArgs(out=out, agent=agent, motions=library, **options)


def history(out, agent):
    """Evaluations of the first stage: errors in cm."""
    stage = next(iter(AGENTS[agent].presets["smoke"].stages))
    state = torch.load(out / stage / "last" / "resume.pt", weights_only=True)
    return [entry["error_cm"] for entry in state["history"]]


@pytest.mark.parametrize("agent", AGENTS)
def test_a_tiny_training_lowers_its_error_and_gives_a_system_that_runs(agent, library, tmp_path):
    out = tmp_path / "run"
    assert train_system(arguments(agent, library, out)) == 0
    errors = history(out, agent)
    assert errors[-1] < 0.95 * errors[0]
    assert read_run(out)["args"]["agent"] == agent
    assert list(out.glob("*/tensorboard/events*"))
    system = load_system(out)
    motion = MOTION.resampled(60.0)
    system.reset(UserBody.of(motion), SETS[agent])
    pose = system.step(readings(motion, SENSOR_SETS[SETS[agent]])[0])
    assert pose.finite()


class StopAfter(Stopper):
    """Asks for a stop when a stage has made so many steps."""

    def __init__(self, steps: int) -> None:
        super().__init__()
        self.left = steps

    @property
    def requested(self) -> bool:  # type: ignore[override]
        self.left -= 1
        return self.left < 0

    @requested.setter
    def requested(self, value: bool) -> None:
        pass


def fit_of(agent: str, stage: str, folder, seed: int = 0, team: Team | None = None) -> Fit:
    torch.manual_seed(seed)
    entry = AGENTS[agent]
    config = entry.presets["smoke"]
    module, learning = entry.build(config.spec), config.stages[stage]
    task = entry.task(module, stage, learning, MotionBank([MOTION], learning.window), 4)

    def save(where, training, resume):
        save_system(where, module, agent, config.spec, training, resume)

    return Fit(
        stage,
        module,
        task,
        learning,
        folder,
        Budget(None, 6),
        save,
        {},
        seed,
        team=team or Nobody(),
    )


@pytest.mark.parametrize(("agent", "stage"), [("hmdposer", "network"), ("dragposer", "vae")])
def test_a_resumed_training_ends_with_the_bits_of_one_in_one_piece(agent, stage, tmp_path):
    with Display() as display:
        whole = fit_of(agent, stage, tmp_path / "whole")
        whole.run(display, Stopper())
        first = fit_of(agent, stage, tmp_path / "parts")
        first.run(display, StopAfter(3))
        assert 0 < first.steps < 6
        second = fit_of(agent, stage, tmp_path / "parts", seed=5)
        second.resume()
        second.run(display, Stopper())
    for name, tensor in whole.module.state_dict().items():
        assert torch.equal(tensor, second.module.state_dict()[name]), name
    assert second.history[-1]["error_cm"] == whole.history[-1]["error_cm"]


class Two(Nobody):
    count = 2


def test_a_training_goes_on_with_another_number_of_workers_and_says_so(tmp_path, capsys):
    with Display() as display:
        fit_of("dragposer", "vae", tmp_path).run(display, StopAfter(3))
        more = fit_of("dragposer", "vae", tmp_path, team=Two())
        more.resume()
        more.run(display, Stopper())
    assert "number of workers (1 before, now 2): it draws other windows" in capsys.readouterr().out
    assert more.steps == 6


def test_a_run_is_neither_overwritten_nor_resumed_with_other_options(library, tmp_path):
    out = tmp_path / "run"
    train_system(arguments("lgsik", library, out, steps=2))
    with pytest.raises(InputError, match="holds a run already"):
        train_system(arguments("lgsik", library, out, steps=2))
    with pytest.raises(InputError, match="--agent was lgsik, not hmdposer"):
        train_system(arguments("hmdposer", library, out, steps=2, resume=True))
    assert train_system(arguments("lgsik", library, out, steps=4, resume=True)) == 0
    assert len(read_run(out)["resumed"]) == 1


def test_motions_that_are_too_short_are_refused_and_leave_no_run(library, tmp_path):
    with pytest.raises(InputError, match="no motion has 129 frames"):
        short = tmp_path / "short.npz"
        save_library(short, [to_motion(swaying_clip(frames=30))], [])
        args = arguments("dragposer", str(short), tmp_path / "run")
        train_system(replace(args, set=("stages.vae.window=129",)))
    assert not (tmp_path / "run" / "run.yaml").exists()


def test_a_training_starts_with_the_weights_of_an_earlier_one_and_its_card_names_both(
    library, tmp_path
):
    first, second = tmp_path / "first", tmp_path / "second"
    train_system(arguments("lgsik", library, first, seed=4))
    train_system(arguments("lgsik", library, second, steps=2, start=first))
    assert history(second, "lgsik")[0] == min(history(first, "lgsik"))
    assert load_module(second / "network" / "best")[1]["training"]["start"] == str(first)
    other = save_library_of(replace(MOTION, licence="CC-BY-NC-4.0"), tmp_path / "other.npz")
    train_system(arguments("lgsik", other, tmp_path / "third", steps=3, start=second))
    train_system(
        arguments("lgsik", library, tmp_path / "fourth", steps=5, start=tmp_path / "third")
    )
    ship(ShipArgs(tmp_path / "fourth", "mine", into=tmp_path / "weights"))
    told = load_module(tmp_path / "weights" / "mine")[1]["training"]
    assert [stage["steps"] for stage in told["stages"]] == [STEPS, 2, 3, 5]
    assert told["licence"] == "CC-BY-NC-4.0"
    assert "--start" not in told["commands"][0] and told["commands"][0].endswith("runs/first")
    assert told["commands"][1].endswith("--out runs/second --start runs/first")
    assert told["commands"][-1].endswith("--out runs/NAME --start runs/third")
    assert told["commands"][-1] in (tmp_path / "weights" / "mine" / "README.md").read_text()


@pytest.mark.parametrize(
    ("agent", "options", "message"),
    [
        ("lgsik", {"start": Path("gone")}, "gone: is not a kinematic system"),
        ("hmdposer", {}, "is of the family lgsik, not hmdposer"),
        (
            "lgsik",
            {"set": ("spec.size=24",)},
            "has networks of other sizes; use its --preset and --set",
        ),
        ("lgsik", {"set": ("spec.graph=false",)}, "has networks of other sizes"),
    ],
)
def test_a_start_that_does_not_fit_is_refused_and_leaves_no_run(
    agent, options, message, library, tmp_path
):
    config = AGENTS["lgsik"].presets["smoke"]
    save_system(tmp_path / "start", AGENTS["lgsik"].build(config.spec), "lgsik", config.spec, {})
    options = {"start": tmp_path / "start"} | options
    with pytest.raises(InputError, match=message):
        train_system(arguments(agent, library, tmp_path / "run", **options))
    assert not (tmp_path / "run").exists()


def test_a_damaged_or_foreign_checkpoint_is_refused(tmp_path):
    config = AGENTS["lgsik"].presets["smoke"]
    folder = tmp_path / "system"
    save_system(folder, AGENTS["lgsik"].build(config.spec), "lgsik", config.spec, {})
    assert find_system(folder) == folder
    text = (folder / "system.yaml").read_text()
    (folder / "system.yaml").write_text(text.replace("left_knee", "left_wing"))
    with pytest.raises(InputError, match="joints is not"):
        load_module(folder)
    for damaged, says in (
        ("size: ", "spec.size is not a whole number"),
        ("size: 2.5", "spec.size is not a whole number"),
        ("size: 10000000", "spec.size is not within 0-4096"),
        ("size: -3", "spec.size is not within"),
        ("size: 0", "cannot be built"),
    ):
        (folder / "system.yaml").write_text(text.replace("  size: 16", f"  {damaged}", 1))
        with pytest.raises(InputError, match=says):
            load_module(folder)
    (folder / "system.yaml").write_text(text.replace("training: {}", "training:"))
    with pytest.raises(InputError, match="training has no list 'trained'"):
        load_module(folder)
    (folder / "system.yaml").write_text(text)
    (folder / "system.safetensors").write_bytes(b"nothing")
    with pytest.raises(InputError, match="the weights do not fit"):
        load_module(folder)


@pytest.fixture(scope="module")
def shipped(tmp_path_factory):
    """A tiny SparsePoser in ``run``, compared in ``scores`` and shipped to ``weights/feet``."""
    folder = tmp_path_factory.mktemp("shipped")
    motions = save_library_of(MOTION, folder / "motions.npz")
    more = {"steps": 2, "seed": 3, "validation": motions}
    train_system(arguments("sparseposer", motions, folder / "run", **more))
    agents, scores = (str(folder / "run"),), folder / "scores"
    compare(CompareArgs(agents=agents, motions=motions, out=scores, threads=1))
    report = scores / "comparison.json"
    args = ShipArgs(folder / "run", "feet", metrics=(report,), into=folder / "weights")
    assert ship(args) == 0
    return folder


def test_a_shipped_system_loads_by_name_and_answers_as_the_run_does(shipped, monkeypatch):
    monkeypatch.setattr("agents.resolve.SHIPPED", shipped / "weights")
    body, seen = UserBody.of(MOTION), readings(MOTION.resampled(60.0), SENSOR_SETS["6T"])
    a, b = (load_system(name).predict(seen, body) for name in ("feet", shipped / "run"))
    assert np.array_equal(a.rotations, b.rotations)
    assert {path.name for path in (shipped / "weights" / "feet").iterdir()} == {
        "README.md", "system.safetensors", "system.yaml",
    }  # fmt: skip


def test_a_run_and_its_card_record_the_shipped_system_it_started_from(
    shipped, monkeypatch, tmp_path
):
    weights = tmp_path / "weights"
    shutil.copytree(shipped / "weights", weights)
    monkeypatch.setattr("agents.resolve.SHIPPED", weights)
    motions = str(shipped / "motions.npz")
    train_system(arguments("sparseposer", motions, tmp_path / "run", steps=2, start=Path("feet")))
    was = read_system_card(weights / "feet")["training"]
    assert read_run(tmp_path / "run")["behind"] == {"start": was}
    shutil.rmtree(weights / "feet")
    folder = find_system(tmp_path / "run")
    assert folder is not None
    told = system_provenance(folder)
    assert told["stages"][:2] == was["stages"] and len(told["stages"]) == 4
    assert told["commands"][0] == was["commands"][0].replace("runs/NAME", "runs/feet")
    assert told["commands"][1].endswith("--start runs/feet")


def test_the_card_of_a_system_has_data_licence_command_seed_time_and_figures(shipped):
    card = (shipped / "weights" / "feet" / "README.md").read_text()
    assert "| licence | MIT |" in card and "| seed | 3 |" in card
    assert "| checkpoints compared on | `runs/motions.npz`: 1 clips |" in card
    assert str(shipped) not in card
    assert "generator 2 steps, 0 min; ik 2 steps, 0 min" in card
    command = next(line for line in card.splitlines() if line.startswith("python train.py"))
    assert "--agent sparseposer" in command and "--preset smoke" in command
    row = json.loads((shipped / "scores" / "comparison.json").read_text())["rows"][1]
    assert f"| 6 | {row['clips']} | {row['pooled']['mpjre_deg']:.2f} |" in card
    training = load_module(shipped / "weights" / "feet")[1]["training"]
    assert [stage["stage"] for stage in training["stages"]] == ["generator", "ik"]


def test_a_system_is_not_shipped_with_figures_of_another_or_without_licence(shipped, tmp_path):
    motions = save_library_of(replace(MOTION, licence=""), tmp_path / "motions.npz")
    out = tmp_path / "run"
    train_system(arguments("lgsik", motions, out, steps=2))
    report = shipped / "scores" / "comparison.json"
    with pytest.raises(InputError, match="has no results of this system"):
        ship(ShipArgs(out, "mine", metrics=(report,), into=tmp_path))
    with pytest.raises(InputError, match="have no stated licence"):
        ship(ShipArgs(out / "network", "mine", into=tmp_path))
    assert not (tmp_path / "mine").exists()


def test_windows_are_reproducible_and_mirrored_and_of_other_people():
    bank = MotionBank([MOTION], 20)
    a = bank.draw(32, np.random.default_rng(1))
    b = bank.draw(32, np.random.default_rng(1))
    assert torch.equal(a.position, b.position)
    heights = a.position[:, 0, HEAD, 2]
    assert heights.std() > 0.01
    plain = bank.draw(32, np.random.default_rng(1), vary=False)
    assert torch.allclose(plain.offsets.norm(dim=-1)[0], plain.offsets.norm(dim=-1)[1], atol=1e-3)


def test_joints_of_a_window_are_on_its_own_bones():
    windows = MotionBank([MOTION], 10).draw(8, np.random.default_rng(0))
    thigh = (windows.position[:, :, 2] - windows.position[:, :, 1]).norm(dim=-1)
    assert torch.allclose(thigh, windows.offsets[:, None, 2].norm(dim=-1).expand(-1, 10), atol=1e-4)


def test_normalised_dual_quaternions_have_mean_zero_and_deviation_one():
    module = AGENTS["sparseposer"].build(AGENTS["sparseposer"].presets["smoke"].spec)
    assert isinstance(module, SparsePoserModule)
    windows = MotionBank([MOTION], 64).fixed(16)
    measure_normalisers(module, windows)
    from agents.kinematic.sparseposer.networks import root_space
    from questsim import differentiable as diff

    dual = root_space(windows.position, diff.matrix_to_quat(windows.world))
    normal = module.normal(dual).flatten(0, 1)
    assert normal.mean(0).abs().max() < 1e-3
    moving = module.std > 2e-3
    assert (normal.std(0)[moving] - 1.0).abs().max() < 1e-3


def test_the_record_of_motions_changes_with_a_single_frame():
    other = replace(MOTION, root_position=MOTION.root_position + 1e-3)
    assert motions_record("x", [MOTION])["sha256"] != motions_record("x", [other])["sha256"]


def test_the_record_of_motions_changes_with_a_weight():
    """Else a training would resume with motions that are drawn differently."""
    other = replace(MOTION, weight=2.0)
    assert motions_record("x", [MOTION])["sha256"] != motions_record("x", [other])["sha256"]


def test_the_learning_rate_rises_from_nothing_over_the_warm_up(tmp_path):
    fit = fit_of("lgsik", "network", tmp_path)
    fit.learning = replace(fit.learning, warm_up=4, final_rate=1.0, learning_rate=1e-3)
    rates = []
    for _ in range(6):
        fit._step(0.0)
        rates.append(fit._descent.optimiser.param_groups[0]["lr"])
    assert np.allclose(rates, [2.5e-4, 5e-4, 7.5e-4, 1e-3, 1e-3, 1e-3])


@pytest.mark.parametrize(
    ("agent", "stage"), [("hmdposer", "network"), ("sparseposer", "generator")]
)
def test_bfloat16_is_for_training_alone_and_answers_nearly_the_same(agent, stage, monkeypatch):
    monkeypatch.setattr(precision, "native_bfloat16", lambda: True)
    torch.manual_seed(0)
    entry = AGENTS[agent]
    config = entry.presets["smoke"]
    module, learning = entry.build(config.spec), config.stages[stage]
    bank = MotionBank([MOTION], learning.window)
    exact, coarse = (
        entry.task(module, stage, replace(learning, bfloat16=on), bank, 4) for on in (False, True)
    )
    batch = exact.draw(np.random.default_rng(0))

    def losses(training):
        module.train(training)
        torch.manual_seed(1)
        first = float(exact.loss(batch)[0].detach())
        torch.manual_seed(1)
        return first, float(coarse.loss(batch)[0].detach())

    first, second = losses(True)
    assert first != second and second == pytest.approx(first, rel=0.03)
    first, second = losses(False)
    assert first == second
    monkeypatch.setattr(precision, "native_bfloat16", lambda: False)
    first, second = losses(True)
    assert first == second


def test_hmdposers_published_rate_falls_to_a_tenth_after_three_quarters():
    learning = AGENTS["hmdposer"].presets["paper"].stages["network"]
    rates = [rate_at(learning, progress, 0, []) for progress in (0.0, 0.74, 0.75, 1.0)]
    assert np.allclose(rates, [1e-3, 1e-3, 1e-4, 1e-4])


def test_lgsiks_published_rate_falls_as_pytorchs_plateau_scheduler_does():
    learning = AGENTS["lgsik"].presets["paper"].stages["network"]
    optimiser = torch.optim.AdamW([torch.nn.Parameter(torch.zeros(1))], lr=1e-3)
    scheduler = torch.optim.lr_scheduler.ReduceLROnPlateau(optimiser, factor=0.1, patience=5)
    errors = [9.0, 8.0, *[8.0] * 7, 7.9, 7.0, *[7.5] * 13]
    for count, error in enumerate(errors, start=1):
        scheduler.step(error)
        want = optimiser.param_groups[0]["lr"]
        assert rate_at(learning, 0.1, 0, errors[:count]) == pytest.approx(want)
    assert want == pytest.approx(1e-6)


def test_a_paper_preset_trains_for_its_published_epochs_unless_a_budget_is_given(tmp_path):
    bank = MotionBank([MOTION], 42)
    config = AGENTS["lgsik"].presets["paper"]
    args = arguments("lgsik", "synthetic", tmp_path, preset="paper", steps=None)
    windows = int(np.ceil(bank.starts / 20).sum())
    assert _budget("network", args, config, bank).steps == np.ceil(150 * windows / 64)
    given = _budget("network", replace(args, minutes=2.0), config, bank)
    assert (given.seconds, given.steps) == (120.0, None)
    cpu = _budget("network", args, AGENTS["lgsik"].presets["cpu"], bank)
    assert (cpu.seconds, cpu.steps) == (3600.0, None)


def test_an_unknown_schedule_is_refused(library, tmp_path):
    args = arguments("lgsik", library, tmp_path / "run", set=("stages.network.schedule=stairs",))
    with pytest.raises(InputError, match="schedule is 'stairs', not one of cosine"):
        train_system(args)


def test_kinds_are_drawn_by_the_power_of_their_frames_that_is_asked_for():
    """12 windows of standing in two clips, 3 of a jump: 80, 67 and 50 % of the draws."""
    whole = MOTION.resampled(60.0)
    motions = [
        replace(
            whole, root_position=whole.root_position[:n], rotations=whole.rotations[:n], kind=kind
        )
        for kind, n in (("stand", 8), ("stand", 8), ("jump", 5))
    ]
    for power, share in ((1.0, 0.8), (0.5, 2 / 3), (0.0, 0.5)):
        bank = MotionBank(motions, 3, kind_power=power)
        assert bank.probability.sum() == pytest.approx(1.0)
        assert bank.probability[:2].sum() == pytest.approx(share)
        assert bank.probability[0] == pytest.approx(bank.probability[1])
        varied = [replace(motions[0], kind="stand+bow"), *motions[1:]]  # counts as standing
        same = MotionBank(varied, 3, kind_power=power)
        assert np.array_equal(same.probability, bank.probability)


def test_checkpoints_are_compared_on_the_motions_of_validation(library, tmp_path):
    told = {}
    for name, validation in (("own", None), ("other", "synthetic:kick")):
        out = tmp_path / name
        assert train_system(arguments("hmdposer", library, out, validation=validation)) == 0
        told[name] = history(out, "hmdposer")
    assert told["own"] != told["other"]
    again = arguments("hmdposer", library, tmp_path / "other", resume=True)
    with pytest.raises(InputError, match="the validation clips differ"):
        train_system(replace(again, validation="synthetic:bow"))
    with pytest.raises(InputError, match="--validation: does not go with --hold-out"):
        train_system(replace(again, validation="synthetic:kick", hold_out="old"))
