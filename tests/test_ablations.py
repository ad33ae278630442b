"""Systems without one of their parts: what each switch changes, and the table of all."""

import csv
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from agents.comparison.ablated import ablated
from agents.comparison.ablation_report import FILES, Result, differences, table
from agents.comparison.ablations import AblationsArgs, ablations
from agents.comparison.report import Row
from agents.kinematic import load_system
from agents.kinematic.data import MotionBank
from agents.kinematic.dragposer.networks import (
    PAST,
    TOKEN,
    AutoregressivePredictor,
    DragPoserSpec,
)
from agents.kinematic.dragposer.training import _limb_noise
from agents.kinematic.interface import UserBody
from agents.kinematic.options import TrainSystemArgs
from agents.kinematic.recurrent.features import ATOMS
from agents.kinematic.recurrent.hmdposer import HmdPoserNet, HmdPoserSpec
from agents.kinematic.recurrent.lgsik import PARTS, LgsikNet, LgsikSpec
from agents.kinematic.recurrent.training import _shape_error
from agents.kinematic.registry import AGENTS
from agents.kinematic.skeletal import MaskedConv, MaskedLinear, PlainMixing
from agents.kinematic.sparseposer.training import _regularisation
from agents.kinematic.store import find_system, load_module, read_system_card, save_system
from agents.kinematic.switches import switches
from agents.kinematic.training import train_system
from agents.kinematic.training_faults import EXACT, drawn
from agents.overrides import with_overrides
from agents.policy.checkpoint import find_policy, load_policy
from questsim.cli import main
from questsim.errors import InputError
from questsim.joint_sensors import readings
from questsim.motion.library import save_library
from questsim.motion.retarget import to_clip
from questsim.motion.retarget_back import to_motion
from questsim.reward import PAPER_REWARD, TERMS, Moment, ReferenceState, summed
from questsim.sensors import SENSOR_SETS
from questsim.skeleton import JOINTS
from tests.helpers import swaying_clip

VARIANTS = {name: entry.variants for name, entry in AGENTS.items()}

MOTION = to_motion(swaying_clip(frames=42)).resampled(60.0)
WINDOWS = {"avatarposer": 18, "hmdposer": 18, "lgsik": 18, "sparseposer": 64, "dragposer": 3}
SETS = {
    "avatarposer": "H+2C", "hmdposer": "H+2C+2IMU", "lgsik": "H+2C+3IMU", "sparseposer": "6T",
    "dragposer": "6T",
}  # fmt: skip
SWITCHED = [
    *[(agent, v.set) for agent in VARIANTS for v in VARIANTS[agent] if v.set],
    ("sparseposer", ("spec.learned_ik=false",)),
    ("dragposer", ("spec.predictor=false",)),
]

FEATURES = torch.randn(2, 5, 135, generator=torch.Generator().manual_seed(1))
TALL, SHORT = torch.ones(2, 11), -torch.ones(2, 11)


@pytest.fixture(autouse=True)
def _few_windows(monkeypatch):
    """Normalisers of these tests need not be good."""
    monkeypatch.setattr("agents.kinematic.sparseposer.training.NORMALISED_BY", 16)


@pytest.fixture
def library(tmp_path):
    path = tmp_path / "motions.npz"
    save_library(path, [MOTION], [])
    return str(path)


def config_of(agent: str, *assignments: str):
    return with_overrides(AGENTS[agent].presets["smoke"], assignments)


def task_of(agent: str, *assignments: str, stage: str | None = None) -> tuple[Any, Any]:
    """An untrained module of the smallest preset with values changed, and a stage's task."""
    torch.manual_seed(0)
    config, entry = config_of(agent, *assignments), AGENTS[agent]
    module = entry.build(config.spec)
    name = stage or next(iter(config.stages))
    bank = MotionBank([MOTION], WINDOWS[agent])
    return module, entry.task(module, name, config.stages[name], bank, 4)


def loss_of(task) -> tuple[torch.Tensor, dict[str, float]]:
    return task.loss(task.draw(np.random.default_rng(0)))


def answers(net: Any, features: torch.Tensor, body: torch.Tensor) -> tuple[Any, Any]:
    """Rotations and shape numbers of a network in use."""
    net.eval()
    with torch.no_grad():
        six, shape, _ = net(features, body)
    return six, shape


def layers(module: torch.nn.Module, kind: type) -> list[Any]:
    return [layer for layer in module.modules() if isinstance(layer, kind)]


# -- every variant -------------------------------------------------------------------------------


@pytest.mark.parametrize(("agent", "values"), SWITCHED, ids=lambda x: x if str(x) == x else x[0])
def test_a_variant_is_saved_and_loaded_with_its_switch_and_answers(agent, values, tmp_path):
    module, _ = task_of(agent, *values)
    config = config_of(agent, *values)
    stage = next(iter(config.stages))
    save_system(tmp_path, module, agent, config.spec, {"trained": [stage]})
    loaded, card = load_module(tmp_path)
    assert card["spec"] == json.loads(json.dumps(asdict(config.spec)))
    same = loaded.state_dict()
    assert all(torch.equal(value, same[name]) for name, value in module.state_dict().items())
    system, seen = load_system(tmp_path), readings(MOTION, SENSOR_SETS[SETS[agent]])
    system.reset(UserBody.of(MOTION), SETS[agent])
    assert all(system.step(seen[t]).finite() for t in range(3))


@pytest.mark.parametrize("agent", AGENTS)
def test_a_checkpoint_from_before_there_were_switches_has_all_parts(agent, tmp_path):
    module, _ = task_of(agent)
    spec = config_of(agent).spec
    save_system(tmp_path, module, agent, spec, {"trained": []})
    card = yaml.safe_load((tmp_path / "system.yaml").read_text())
    added = switches(type(spec))
    assert added and added < set(card["spec"])
    card["spec"] = {name: value for name, value in card["spec"].items() if name not in added}
    (tmp_path / "system.yaml").write_text(yaml.safe_dump(card))
    loaded = load_module(tmp_path)[0].state_dict()
    assert loaded.keys() == module.state_dict().keys()
    card["spec"].popitem()
    (tmp_path / "system.yaml").write_text(yaml.safe_dump(card))
    with pytest.raises(InputError, match="the description of the networks is incomplete"):
        load_module(tmp_path)


@pytest.mark.parametrize("agent", VARIANTS)
def test_a_variant_changes_every_preset_or_the_run_alone(agent):
    for variant in VARIANTS[agent]:
        assert bool(variant.set) != bool(variant.options)
        for preset in AGENTS[agent].presets.values():
            assert not variant.set or with_overrides(preset, variant.set) != preset


# -- LGSIK-Poser ---------------------------------------------------------------------------------


def lgsik(**switched: Any) -> LgsikNet:
    torch.manual_seed(0)
    return LgsikNet(LgsikSpec(size=8, hidden=(16, 16), shape_hidden=8, **switched))


def right_leg_before_its_head(net: LgsikNet, features: torch.Tensor) -> torch.Tensor:
    """What the second LSTMs read for the right leg."""
    seen: list[torch.Tensor] = []
    handle = net.second.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    answers(net, features, TALL)
    handle.remove()
    return seen[0][:, :, list(PARTS).index("right_leg")]


def test_without_graph_convolution_the_right_leg_does_not_depend_on_the_left_legs_sensor():
    full, plain = lgsik(), lgsik(graph=False)
    assert len(layers(full, MaskedLinear)) == 3 and not layers(plain, MaskedLinear)
    assert plain.first.groups == len(PARTS)
    moved = FEATURES.clone()
    moved[..., ATOMS["left_leg"]] += 1.0
    for net, knows in ((full, True), (plain, False)):
        before, after = (right_leg_before_its_head(net, x) for x in (FEATURES, moved))
        assert torch.equal(before, after) is not knows


def test_without_ik_heads_one_layer_answers_all_joints():
    full, plain = lgsik(), lgsik(ik_heads=False)
    assert len(full.last_layers()) == len(PARTS)
    assert [layer.out_features for layer in plain.last_layers()] == [6 * len(JOINTS)]
    six, shape = answers(plain, FEATURES, TALL)
    assert six.shape == (2, 5, len(JOINTS), 6) and shape.shape == (2, 5, 16)


@pytest.mark.parametrize("graph", [True, False])
def test_without_the_shape_group_the_answer_does_not_depend_on_measurements(graph):
    for shape_group in (True, False):
        net = lgsik(shape_group=shape_group, graph=graph)
        (six, shape), (short_six, short_shape) = (
            answers(net, FEATURES, body) for body in (TALL, SHORT)
        )
        assert torch.equal(shape, short_shape) is not shape_group
        # Without graph convolutions nothing brings measurements to the rotations either.
        assert torch.equal(six, short_six) is not (shape_group and graph)


def test_lgsik_can_be_trained_by_hmdposers_loss_and_by_no_unknown_one():
    own, other = (
        loss_of(task_of("lgsik", f"spec.loss={loss}")[1])[1] for loss in ("lgsik", "hmdposer")
    )
    published = loss_of(task_of("hmdposer")[1])[1]
    assert {"sparse", "velocity"} < own.keys()
    assert other.keys() == published.keys() and "acceleration" in other
    with pytest.raises(InputError, match="no loss 'l3'; lgsik or lgsik-lengths or hmdposer"):
        LgsikNet(LgsikSpec(loss="l3"))


# -- HMD-Poser -----------------------------------------------------------------------------------


def hmdposer(**switched: Any) -> HmdPoserNet:
    torch.manual_seed(0)
    spec = HmdPoserSpec(size=32, blocks=1, layers=1, heads=4, feed_forward=32, head_hidden=16)
    return HmdPoserNet(replace(spec, **switched))


def test_without_hands_in_head_their_numbers_are_not_read():
    full, plain = hmdposer(), hmdposer(hands_in_head=False)
    assert len(full.embeddings) == 8 and len(plain.embeddings) == 6
    moved = FEATURES.clone()
    moved[..., ATOMS["left_in_head"]] += 1.0
    for net, reads in ((full, True), (plain, False)):
        before, after = (answers(net, x, TALL)[0] for x in (FEATURES, moved))
        assert torch.equal(before, after) is not reads


def test_without_a_shape_head_every_user_has_the_mean_body():
    module, _ = task_of("hmdposer", "spec.shape_head=false")
    _, shape = answers(module.net, FEATURES, TALL)
    assert not shape.any()
    assert torch.equal(module.bones(shape[0, 0]), module.template)
    assert answers(hmdposer(), FEATURES, TALL)[1].any()


def test_hmdposers_loss_goes_without_a_term_of_weight_zero():
    whole, whole_terms = loss_of(task_of("hmdposer")[1])
    without, terms = loss_of(task_of("hmdposer", "stages.network.weights.acceleration=0")[1])
    assert terms.pop("acceleration") == 0.0 < whole_terms["acceleration"]
    assert terms == {name: whole_terms[name] for name in terms}
    assert float((whole - without).detach()) == pytest.approx(whole_terms["acceleration"], rel=1e-4)


def test_errors_of_the_devices_have_the_sizes_of_the_preset():
    assert drawn(EXACT, (2, 3, 6), np.random.default_rng(0)) is None
    noise = {"position_m": 0.005, "mount_rad": 0.17, "mount_m": 0.03, "rotation_rad": 0.02}
    faults = drawn(noise, (40, 18, 6), np.random.default_rng(0))
    assert faults is not None
    still, upright = torch.zeros(40, 18, 6, 3), torch.eye(3).expand(40, 18, 6, 3, 3)
    position, rotation = faults.apply(still, upright)
    # The mean over the frames of a window is its mount; what is left is white.
    mounts = position.mean(dim=1, keepdim=True)
    assert 0.02 < mounts.norm(dim=-1).max() < 0.034
    white = (position - mounts).std() * (18 / 17) ** 0.5
    assert float(white) == pytest.approx(0.005, rel=0.05)
    # cos(angle) of the turns: 0.17 rad and what white noise adds.
    cosine = (rotation.diagonal(dim1=-2, dim2=-1).sum(dim=-1) - 1) / 2
    assert 0.15 < float(torch.acos(cosine.clamp(max=1)).max()) < 0.17 + 0.1
    exact, noisy = (
        loss_of(task_of("hmdposer", *words)[1])[1]["error_cm"]
        for words in ((), ("stages.network.noise.position_m=0.5",))
    )
    assert exact != noisy


@pytest.mark.parametrize(
    ("agent", "stage"),
    [("avatarposer", "network"), ("sparseposer", "generator"), ("sparseposer", "ik")],
)
def test_errors_of_the_devices_change_what_is_read_and_not_what_is_learnt(agent, stage):
    word = f"stages.{stage}.noise.position_m=0.5"
    pairs = [task_of(agent, *words, stage=stage) for words in ((), (word,))]
    for module, _ in pairs:
        module.eval()
    exact, noisy = (task for _, task in pairs)
    (true, none), (measured, faults) = (
        task.draw(np.random.default_rng(0)) for task in (exact, noisy)
    )
    assert none is None and faults is not None
    assert torch.equal(true.position, measured.position)
    errors = [
        task.loss(batch)[1]["error_cm"] for task in (exact, noisy) for batch in [(true, None)]
    ]
    assert errors[0] == errors[1] != noisy.loss((measured, faults))[1]["error_cm"]
    # Checkpoints are compared on signals with these errors, too.
    assert exact.validate()["error_cm"] != noisy.validate()["error_cm"]
    assert noisy.validate() == noisy.validate()


# -- SparsePoser ---------------------------------------------------------------------------------


def test_without_skeletal_operations_every_joint_reaches_every_joint():
    full, _ = task_of("sparseposer")
    plain, _ = task_of("sparseposer", "spec.skeletal=false")
    for kind in (MaskedLinear, MaskedConv):
        assert not all(bool(layer.mask.all()) for layer in layers(full.generator, kind))
        assert all(bool(layer.mask.all()) for layer in layers(plain.generator, kind))
    assert not layers(full, PlainMixing) and len(layers(plain, PlainMixing)) == 6
    assert not [name for name, _ in plain.generator.named_buffers() if "pool" in name]


@pytest.mark.parametrize("skeletal", [True, False])
def test_an_unpooled_toe_depends_on_the_hands_only_without_the_skeleton(skeletal):
    module, _ = task_of("sparseposer", f"spec.skeletal={str(skeletal).lower()}")
    generator, channels = module.generator, 8
    x = torch.zeros(1, 14 * channels, 4)
    x[:, -channels:] = 1.0  # the last joint of 14 is the right wrist
    spread = generator._spread("unpool_0", x, channels).unflatten(1, (22, channels)).detach()
    toe, wrist = (spread[:, JOINTS.index(n)].abs().max() for n in ("left_toe", "right_wrist"))
    assert float(wrist) > 0 and (float(toe) > 0) is not skeletal


def test_without_regularisation_the_limbs_distance_from_the_generator_does_not_count():
    values = "stages.ik.weights.keep"
    totals, kept = [], 0.0
    for weight in ("0", "1000", "2000"):
        module, task = task_of("sparseposer", f"{values}={weight}", stage="ik")
        torch.nn.init.ones_(module.ik["left_leg"][-1].bias)
        total, figures = loss_of(task)
        totals.append(float(total.detach()))
        kept = figures["keep"]
    assert kept > 0
    assert totals[1] - totals[0] == pytest.approx(1000 * kept, rel=1e-3)
    assert totals[2] - totals[1] == pytest.approx(1000 * kept, rel=1e-3)


def test_the_regularisation_reads_all_joints_but_the_ends():
    dual, offsets = torch.zeros(1, 2, 22, 8), torch.randn(1, 22, 3)
    dual[..., 0] = 1.0
    turned = {}
    for name in ("left_wrist", "left_elbow", "left_ankle"):
        other = dual.clone()
        other[:, :, JOINTS.index(name), :4] = torch.tensor([0.8, 0.6, 0.0, 0.0])
        turned[name] = float(_regularisation(other, dual, offsets))
    # Only the toe, an end, is moved by the ankle; its own rotation counts.
    assert turned["left_wrist"] == 0.0 and turned["left_elbow"] > 0.01 < turned["left_ankle"]


# -- LGSIK-Poser's shape --------------------------------------------------------------------------


def test_as_published_only_changes_of_the_shape_in_a_window_count():
    shape = torch.ones(2, 5, 16)
    windows = MotionBank([MOTION], 18).fixed(2)
    for loss, blind in (("lgsik", True), ("lgsik-lengths", False)):
        module, _ = task_of("lgsik", f"spec.loss={loss}")
        assert (float(_shape_error(module, shape, windows)) == 0.0) is blind
        wandering = shape + torch.linspace(0, 1, 5)[:, None]
        assert float(_shape_error(module, wandering, windows)) > 0.0


# -- DragPoser -----------------------------------------------------------------------------------


def test_the_published_predictor_decodes_what_it_is_taught_to_and_sees_no_future():
    predictor = AutoregressivePredictor(DragPoserSpec(feed_forward=32, published=True)).eval()
    past = torch.randn(2, PAST, TOKEN)
    with torch.no_grad():
        free = predictor(past, 4)
        assert torch.allclose(predictor.taught(past, free), free, atol=1e-5)
        other = free.clone()
        other[:, 2:] += 1.0
        taught = predictor.taught(past, other)
    assert torch.allclose(taught[:, :3], free[:, :3], atol=1e-5)
    assert not torch.allclose(taught[:, 3], free[:, 3], atol=1e-3)


def test_a_tenth_of_the_limbs_is_noise_in_all_past_tokens_but_the_last():
    noise = _limb_noise(np.random.default_rng(0), "predictor", 500)
    drawn = ~torch.isnan(noise)
    assert (
        not drawn[:, -1].any()
        and not drawn[:, :, [JOINTS.index("root"), JOINTS.index("head")]].any()
    )
    arm = [JOINTS.index(f"left_{part}") for part in ("clavicle", "shoulder", "elbow", "wrist")]
    hit = drawn[:, 0, arm[0], 0]
    assert torch.equal(drawn[:, :-1, arm].all(dim=(1, 2, 3)), hit)
    assert 0.06 < float(hit.float().mean()) < 0.14
    assert float(noise[drawn].std()) == pytest.approx(1.0, abs=0.02)


def test_without_continuity_its_term_is_gone():
    (total, figures), (less, without) = (
        loss_of(task_of("dragposer", f"stages.vae.weights.continuity={weight}")[1])
        for weight in ("1", "0")
    )
    assert "continuity" not in without
    assert float((total - less).detach()) == pytest.approx(figures["continuity"], rel=1e-4)


# -- parts with a stage of their own -------------------------------------------------------------


@pytest.mark.parametrize(
    ("agent", "switch", "stages", "option"),
    [
        ("sparseposer", "learned_ik", ["generator"], "learned_ik"),
        ("dragposer", "predictor", ["vae"], "predictor"),
    ],
)
def test_the_stage_of_a_part_that_is_left_out_is_not_trained(
    agent, switch, stages, option, library, tmp_path
):
    out = tmp_path / "run"
    values = (f"spec.{switch}=false",)
    needed = AGENTS[agent].needed(config_of(agent, *values))
    assert list(needed.stages) == stages and needed.stages[stages[0]].share == 1.0
    arguments = TrainSystemArgs(
        out=out, agent=agent, motions=library, preset="smoke", steps=1, threads=1, set=values
    )
    assert train_system(arguments) == 0
    folder = find_system(out)
    assert folder is not None and read_system_card(folder)["training"]["trained"] == stages
    system = load_system(out)
    seen = readings(MOTION, SENSOR_SETS["6T"])
    system.reset(UserBody.of(MOTION), "6T")
    assert all(system.step(seen[t]).finite() for t in range(5))
    with pytest.raises(InputError, match="was trained without"):
        load_system(out, **{option: True})


# -- the command ---------------------------------------------------------------------------------


def arguments(agent, library, out, **more) -> AblationsArgs:
    options = {"steps": 2, "threads": 1, "preset": "smoke"} | more
    return AblationsArgs(agent=agent, motions=library, test=library, out=out, **options)


def test_one_command_trains_and_scores_the_full_system_and_all_variants(
    library, tmp_path, capsys, monkeypatch
):
    out = tmp_path / "out"
    assert ablations(arguments("sparseposer", library, out)) == 0
    report = json.loads((out / "ablations.json").read_text())
    names = ["full", *(variant.name for variant in VARIANTS["sparseposer"])]
    assert [row["variant"] for row in report["rows"]] == names
    assert {row["scenario"] for row in report["rows"]} == {"6"}
    full, other = report["rows"][0], report["rows"][3]
    apart = other["pooled"]["pos_cm"] - full["pooled"]["pos_cm"]
    assert apart != 0 and other["differences"]["pooled"]["pos_cm"] == pytest.approx(apart)
    assert other["parameters"] > full["parameters"]
    assert read_system_card(out / "no-skeleton" / "ik" / "last")["spec"]["skeletal"] is False
    # Without learned IK it is the full system's weights: nothing else is trained.
    assert [path.name for path in (out / "no-learned-ik").iterdir()] == ["scores.json"]
    assert report["variants"][1]["training"] == report["variants"][0]["training"]
    page = (out / "ablations.md").read_text()
    assert "| full | " in page and f"({apart:+.2f})" in page and "Preset `smoke`, seed 0" in page
    with (out / "ablations.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 2 * len(names) and float(lines[0]["pos_cm_difference"]) == 0.0
    assert "| no-skeleton | " in capsys.readouterr().out

    # What is done is not done again; what is missing is.
    (out / "no-skeleton" / "scores.json").unlink()
    trained = []
    monkeypatch.setattr(
        "agents.comparison.ablated.train_system", lambda args: trained.append(args.out.name) or 0
    )
    for name in FILES:
        (out / name).unlink()
    assert ablations(arguments("sparseposer", library, out, resume=True)) == 0
    assert trained == ["no-skeleton"]
    again = json.loads((out / "ablations.json").read_text())["rows"]
    assert [row["pooled"]["pos_cm"] for row in again] == [
        row["pooled"]["pos_cm"] for row in report["rows"]
    ]


def test_some_variants_can_run_alone_and_the_others_be_added_later(library, tmp_path):
    out = tmp_path / "out"
    args = arguments("lgsik", library, out, steps=1, variants=("no-graph",))
    assert ablations(args) == 0
    rows = json.loads((out / "ablations.json").read_text())["rows"]
    assert [(row["variant"], row["scenario"]) for row in rows] == [
        (variant, devices) for devices in ("HMD", "HMD+2IMU", "HMD+3IMU")
        for variant in ("full", "no-graph")
    ]  # fmt: skip
    more = replace(args, resume=True, variants=("no-graph", "hmdposer-loss"))
    assert ablations(more) == 0
    assert len(json.loads((out / "ablations.json").read_text())["rows"]) == 9
    with pytest.raises(InputError, match="--steps was 1, not 3"):
        ablations(replace(more, steps=3))
    with pytest.raises(InputError, match="holds a run already"):
        ablations(args)


def test_other_seeds_and_a_performer_held_out_are_rows_of_their_own(library, tmp_path):
    longer = to_motion(swaying_clip(frames=60)).resampled(60.0)
    old, young = replace(MOTION, name="old", style="old"), replace(longer, name="y", style="young")
    save_library(library, [old, young], [])
    out = tmp_path / "out"
    args = arguments(
        "avatarposer", library, out, seeds=2, hold_out="young", variants=("seed-1", "held-out")
    )
    assert ablations(args) == 0
    report = json.loads((out / "ablations.json").read_text())
    rows = {(row["variant"], row["scenario"]): row["pooled"] for row in report["rows"]}
    names = ("full", "seed-1", "held-out")
    assert list(rows) == [(name, where) for where in ("HMD", "HMD; young") for name in names]
    everyone = {name: rows[name, "HMD"]["mpjpe_cm"] for name in names}
    assert len(set(everyone.values())) == 3
    assert all(rows[name, "HMD; young"]["mpjpe_cm"] != everyone[name] for name in names)
    card = {name: read_system_card(out / name / "network" / "last") for name in names}
    assert [card[name]["training"]["seed"] for name in names] == [0, 1, 0]
    assert [card[name]["training"].get("hold_out") for name in names] == [
        None,
        None,
        "young",
    ]
    assert "Rows `seed-` are the same training" in (out / "ablations.md").read_text()
    # A third seed is added later; the others are not trained again.
    more = replace(args, resume=True, seeds=3, variants=("seed-2",))
    assert ablations(more) == 0
    with pytest.raises(InputError, match="--hold-out was young, not old"):
        ablations(replace(more, hold_out="old"))


def test_styles_that_the_training_lacks_are_refused_before_the_full_system_is_trained(
    library, tmp_path, monkeypatch
):
    young = replace(MOTION, name="y", style="young")
    save_library(library, [replace(MOTION, name="o", style="old"), young], [])
    training = tmp_path / "training.npz"
    save_library(training, [replace(MOTION, name="o", style="old")], [])
    trained = []
    monkeypatch.setattr("agents.comparison.ablated.train_system", lambda _: trained.append(1) or 0)
    args = arguments("lgsik", library, tmp_path / "out", hold_out="young")
    args = replace(args, motions=str(training))
    with pytest.raises(InputError, match="no clip has style 'young'"):
        ablations(args)
    assert not trained and not (tmp_path / "out").exists()


def test_ablations_stopped_during_a_training_can_be_continued(library, tmp_path, monkeypatch):
    out = tmp_path / "out"
    monkeypatch.setattr("agents.comparison.ablated.train_system", lambda args: 130)
    args = arguments("dragposer", library, out)
    assert ablations(args) == 130
    assert not (out / "ablations.md").exists()
    with pytest.raises(InputError, match="holds a run already; add --resume"):
        ablations(args)
    assert ablations(replace(args, resume=True)) == 130


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--agent", "nobody"], "no ablations of 'nobody'"),
        (["--agent", "lgsik", "--steps", "1"], "--out: is missing"),
        (["--agent", "lgsik", "--out", "OUT"], "--minutes: ablations need a budget"),
        (["--agent", "lgsik", "--out", "OUT", "--minutes", "0"], "--minutes: is 0, not above 0"),
        (["--agent", "lgsik", "--out", "OUT", "--minutes", "-1"], "--minutes: is -1, not above"),
        (["--agent", "lgsik", "--out", "OUT", "--steps", "0"], "--steps: is 0"),
        (["--agent", "lgsik", "--out", "OUT", "--steps", "1", "--variants", "x"], "--variants"),
        (["--agent", "lgsik", "--out", "OUT", "--steps", "1", "--set", "spec.x=1"], "no 'x'"),
        (["--agent", "lgsik", "--out", "OUT", "--steps", "1", "--test", "gone.npz"], "gone.npz"),
        (["--agent", "lgsik", "--out", "OUT", "--steps", "1", "--motions", "gone.npz"], "gone"),
        (["--agent", "lgsik", "--out", "OUT", "--steps", "1", "--resume"], "no run to resume"),
        (["--agent", "lgsik", "--out", "OUT", "--steps", "1", "--seeds", "0"], "--seeds: is 0"),
        (["--agent", "lgsik", "--out", "OUT", "--steps", "1", "--hold-out", "x"], "style 'x'"),
    ],
)
def test_ablations_that_cannot_run_are_refused_in_one_line_and_leave_no_files(
    options, message, library, tmp_path, capsys
):
    out = tmp_path / "out"
    words = [str(out) if word == "OUT" else word for word in options]
    for option in ("--test", "--motions"):
        words += [] if option in words else [option, library]
    assert main(["ablations", *words]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ") and told.count("\n") == 1 and message in told
    assert not out.exists()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--agent lgsik --seeds 2 --variants no-graph",
         "--seeds: trains seed-1, which --variants leaves out; add seed-1 to --variants"),
        ("--agent lgsik --hold-out old --variants no-graph",
         "--hold-out: trains held-out, which --variants leaves out"),
        ("--agent lgsik --stage teacher", "--stage: is for questsim; leave it out"),
        ("--agent questsim --stage student", "add e.g. --teacher"),
        ("--agent questsim --teacher tracker",
         "--teacher: is for the stage that learns from a teacher; add --stage student"),
        ("--agent questsim --stage teacher --variants future-0", "there is no 'future-0'"),
        ("--agent questsim --stage ppo", "has no stage 'ppo'"),
    ],
)  # fmt: skip
def test_options_of_ablations_that_would_do_nothing_are_refused(
    line, message, library, tmp_path, capsys
):
    save_library(library, [replace(MOTION, name="o", style="old"), MOTION], [to_clip(MOTION)])
    out = tmp_path / "out"
    words = ["--steps", "1", "--motions", library, "--test", library, "--out", str(out)]
    assert main(["ablations", *line.split(), *words]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ") and told.count("\n") == 1 and message in told
    assert not out.exists()


def test_a_difference_is_given_only_where_both_have_the_figure():
    full = Row("full", "6", 10, {}, {"pos_cm": 2.0, "ee_cm": None}, 1.0)
    other = Row("less", "6", 5, {}, {"pos_cm": 3.5, "ee_cm": 1.0, "rot_deg": 4.0}, 1.0)
    assert differences(other, full, "pooled") == {"pos_cm": 1.5, "ee_cm": None, "rot_deg": None}
    training = {"network": {"steps": 1200, "minutes": 3.0}}
    results = [Result(row.agent, "", (), {}, training, [row]) for row in (full, other)]
    lines = table(results, "sparseposer", "pooled").splitlines()
    assert lines[2] == "| full | 2.00 | - | - | - | - | - | - | 10 | 1,200 |"
    assert lines[3] == "| less | 3.50 (+1.50) | 4.00 | - | - | 1.00 | - | - | 5 | 1,200 |"


def test_questsim_without_its_controllers_is_trained_and_scored_beside_the_whole(
    library, tmp_path, capsys
):
    out = tmp_path / "out"
    small = ("num_envs=2", "validation_clips=1", "stages.ppo.policy.hidden=[8]",
             "stages.ppo.learning.rollout_steps=4", "stages.ppo.learning.minibatch=8")  # fmt: skip
    save_library(library, [MOTION], [to_clip(MOTION)])
    args = arguments(
        "questsim", library, out, preset="paper", steps=8, variants=("headset-only",), set=small
    )
    assert ablations(args) == 0
    report = json.loads((out / "ablations.json").read_text())
    full, headset = report["rows"]
    assert (full["scenario"], headset["variant"]) == ("from the user's state", "headset-only")
    assert headset["parameters"] < full["parameters"]  # it observes less
    assert report["variants"][0]["training"]["ppo"]["steps"] == 8
    page = (out / "ablations.md").read_text()
    assert "- `headset-only`: the controllers; `--sensors H`" in page
    assert "success_percent" in capsys.readouterr().out


def test_the_variants_of_questsim_change_the_stages_that_are_trained_by_reward():
    policies = ablated("questsim")
    paper = {variant.name: variant for variant in policies.variants("paper")}
    assert dict(paper["future-0"].args) == {"future_frames": 0}
    assert policies.preset("paper", paper["no-contact"].set).stages["ppo"].reward.contact == 0.0
    blocks = policies.preset("paper", paper["no-scale"].set).stages["ppo"].policy.actor_blocks
    assert blocks == ("o_sim", "o_user")
    # The teacher of preset cpu has no contact term: the variant adds it.
    cpu = {variant.name: variant for variant in policies.variants("cpu")}
    stages = policies.preset("cpu", (*cpu["contact"].set, *cpu["sums"].set)).stages
    assert stages["teacher"].reward.contact == 0.2
    assert stages["teacher"].reward.k_link_positions == 16 * 60.0
    assert stages["student"] == policies.preset("cpu", ()).stages["student"]
    assert "finetune" not in " ".join(cpu["sums"].set)  # not in the default budget


def test_one_stage_of_questsim_has_the_variants_that_change_it(library, tmp_path):
    teacher = {v.name for v in ablated("questsim", "teacher").variants("cpu")}
    assert teacher == {"contact", "sums", "no-scale"}
    student = ablated("questsim", "student", Path("tracker"))
    without = {v.name: v for v in student.variants("cpu")}
    assert set(without) == {"future-3", "future-1", "future-0", "headset-only", "no-scale"}
    assert all("stages.student." in part for part in without["no-scale"].set)

    save_library(library, [MOTION], [to_clip(MOTION)])
    small = ("num_envs=2", "validation_clips=1", "stages.student.policy.hidden=[8]",
             "stages.student.learning.minibatch=8")  # fmt: skip
    args = arguments(
        "questsim", library, tmp_path / "out", preset="cpu", stage="student", steps=32, set=small,
        teacher=Path("tracker"), variants=("future-0", "no-scale"),
    )  # fmt: skip
    assert ablations(args) == 0
    report = json.loads((tmp_path / "out" / "ablations.json").read_text())
    assert (report["context"]["stage"], report["context"]["teacher"]) == ("student", "tracker")
    assert [list(variant["training"]) for variant in report["variants"]] == [["student"]] * 3
    full, now, without_scale = report["rows"]
    assert now["parameters"] < without_scale["parameters"] < full["parameters"]
    # The network does not observe the stature; its balance term does.
    policy = load_policy(find_policy(tmp_path / "out" / "no-scale")).policy
    assert policy.spec.actor_blocks == ("o_sim", "o_user") and policy.spec.balance == "feet"
    assert "o_scale" in policy.layout.blocks


def test_a_reward_of_sums_has_the_published_formula():
    rng = np.random.default_rng(0)
    angles, links = rng.normal(0.0, 0.02, (2, 5, 33)), rng.normal(0.0, 0.02, (2, 5, 16, 3))
    turns = np.zeros((5, 16, 4))
    reference = ReferenceState(angles[0], angles[0], links[0], links[0], turns)
    force = np.zeros((5, 2))
    moment = Moment(angles[1], angles[1], links[1], links[1], turns, force, force,
                    angles[0], angles[0], reference)  # fmt: skip
    config = summed(PAPER_REWARD)
    for name, k, error in (
        ("joint_angles", 40.0, (angles[1] - angles[0]) ** 2),
        ("joint_velocities", 0.3, (angles[1] - angles[0]) ** 2),
        ("link_positions", 6.0, (links[1] - links[0]) ** 2),
        ("link_velocities", 2.0, (links[1] - links[0]) ** 2),
    ):
        found = TERMS[name].function(moment, getattr(config, f"k_{name}"))
        np.testing.assert_allclose(found, np.exp(-k * error.reshape(5, -1).sum(axis=1)))
