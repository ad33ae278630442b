"""Stages and runs: what is saved, and what going on means."""

from __future__ import annotations

import io
import shutil
import signal
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from fake_env import FakeVecEnv
from helpers import swaying_clip
from learners import nothing, small_ppo

from agents.agent import Needs
from agents.evaluation.follow import Followed, choose_clips
from agents.loading import load_agent
from agents.policy.checkpoint import CRITIC_FILE, load_resume, read_card
from agents.policy.policy_agent import PolicyAgent
from agents.policy.spec import SPARSE_BLOCKS, PolicySpec
from agents.shipping.provenance import stages_behind
from agents.training import train_policy as training
from agents.training.learner import TrainingError
from agents.training.monitor import Display, evaluation_figures
from agents.training.options import TrainArgs
from agents.training.presets import PRESETS, PPOConfig
from agents.training.stage import Budget, Stage, Stopper
from agents.training.train_policy import train
from agents.training.training_clips import split_validation
from questsim.errors import InputError
from questsim.motion.clip import Clip


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def followed(score: float) -> Followed:
    return Followed(
        frames=np.array([10, 5]),
        fell=np.array([False, True]),
        total_reward=np.array([10.0, 10.0]) * score,
        length=np.array([10, 10]),
        kinds=("walk", "run"),
        mean_error_m=np.array([0.1, 0.4]),
        seconds=1.0,
    )


def test_evaluation_figures_weigh_falls():
    figures = evaluation_figures(followed(0.5))
    assert figures["score"] == 0.5
    assert figures["tracked"] == 0.5
    assert figures["link_error_cm"] == pytest.approx(20.0)
    assert figures["tracked_walk"] == 1.0
    assert figures["tracked_run"] == 0.0


def make_stage(folder: Path, seed: int = 0, steps: int = 512, scores=None, **options) -> Stage:
    env = FakeVecEnv(8, seed)
    scores = iter(scores) if scores is not None else None
    return Stage(
        name="teacher",
        learner=small_ppo(env, seed),
        env=env,
        needs=Needs(privileged=True),
        folder=folder,
        budget=Budget(None, steps),
        validate=lambda agent: followed(next(scores) if scores else 0.5),
        evaluate_every=256,
        record={},
        **options,
    )


def run(stage: Stage) -> Stage:
    with Display() as display:
        stage.run(display, Stopper())
    return stage


def test_resumed_stage_is_in_the_state_it_was_saved_in(tmp_path):
    first = run(make_stage(tmp_path))
    again = make_stage(tmp_path, seed=9, steps=1024)
    again.resume()
    assert again.learner.num_timesteps == 512
    a, b = first.learner.state_dict(), again.learner.state_dict()
    for name, tensor in a["policy"].items():
        assert torch.equal(tensor, b["policy"][name]), name
    for i, moments in a["optimizer"]["state"].items():
        assert torch.equal(moments["exp_avg_sq"], b["optimizer"]["state"][i]["exp_avg_sq"])
    assert torch.equal(a["generator"], b["generator"])
    assert a["actor_rate"] == b["actor_rate"]
    assert first.env.get_state()["random"] == again.env.get_state()["random"]
    assert again.history == first.history
    assert again.budget.elapsed > again.budget.spent > 0
    run(again)
    assert again.learner.num_timesteps == 1024
    assert again.history[-1]["steps"] == 1024


def test_resumed_stage_continues_as_the_interrupted_one_would_have(tmp_path):
    """From the same simulation state, the same bits; also of inputs that keep their statistics."""
    first, again = make_stage(tmp_path), make_stage(tmp_path, seed=9)
    norm = first.learner.policy.actor.norm
    norm.held = torch.arange(norm.mean.numel()) % 2 == 0
    run(first)
    again.resume()
    for stage in (first, again):
        stage.learner.player.observation = stage.env.reset()  # type: ignore[attr-defined]
        stage.learner.iterate(nothing, 0.0)
    a, b = (stage.learner.policy.state_dict() for stage in (first, again))
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert a["actor.norm.mean"][::2].abs().max() == 0 < a["actor.norm.mean"][1::2].abs().max()


def test_best_checkpoint_is_that_of_the_best_evaluation(tmp_path):
    run(make_stage(tmp_path, steps=768, scores=[0.1, 0.4, 0.3, 0.2]))
    best = yaml.safe_load((tmp_path / "best" / "policy.yaml").read_text())
    last = yaml.safe_load((tmp_path / "last" / "policy.yaml").read_text())
    assert best["training"]["steps"] == 256
    assert last["training"]["steps"] == 768
    assert not (tmp_path / "kept").exists()


def test_a_stage_keeps_every_evaluated_policy_if_asked(tmp_path):
    run(make_stage(tmp_path, steps=512, keep=True))
    steps = [read_card(f)["training"]["steps"] for f in sorted((tmp_path / "kept").iterdir())]
    assert steps == [0, 256, 512]


def test_fine_tuning_that_does_not_help_is_not_kept(tmp_path):
    run(make_stage(tmp_path / "worse", scores=[0.5, 0.4, 0.3], must_improve=True))
    assert not (tmp_path / "worse" / "best").exists()
    run(make_stage(tmp_path / "better", scores=[0.5, 0.4, 0.6], must_improve=True))
    assert (tmp_path / "better" / "best").exists()


def test_ctrl_c_ends_the_stage_after_the_iteration_and_saves(tmp_path):
    def interrupt(steps: int) -> None:
        if steps == 256:
            signal.raise_signal(signal.SIGINT)

    stopper = Stopper()
    stage = make_stage(tmp_path, steps=10_000, before_iteration=interrupt)
    with Display() as display, stopper.listening():
        stage.run(display, stopper)
    assert stopper.requested
    assert load_resume(tmp_path / "last")["learner"]["steps"] == 384


def test_not_finite_reward_keeps_the_last_good_checkpoint(tmp_path):
    def poison(steps: int) -> None:
        if steps == 512:
            stage.env.reference = lambda ahead: np.full((8, 33), np.nan)

    stage = make_stage(tmp_path, steps=10_000, before_iteration=poison)
    with pytest.raises(TrainingError, match="step 520"):
        run(stage)
    kept = load_agent(tmp_path / "last")
    assert isinstance(kept, PolicyAgent)
    assert kept.card["training"]["steps"] == 512


def test_budget_ends_with_time_or_steps_whichever_comes_first():
    assert Budget(None, 100).progress(50) == 0.5
    assert Budget(100.0, None, spent=150.0).progress(0) > 1
    assert Budget(1e6, 100).progress(100) == 1.0
    assert Budget(0.0, None).progress(0) == 1.0


def test_fixed_evaluation_set_has_every_kind_and_does_not_depend_on_order():
    clips = [swaying_clip(f"{kind}{i}", frames=12, kind=kind) for kind in "abcd" for i in range(10)]
    chosen = choose_clips(clips, 8)
    assert sorted({clip.kind for clip in chosen}) == list("abcd")
    assert [c.name for c in choose_clips(clips[::-1], 8)] == [c.name for c in chosen]
    assert len(choose_clips(clips, 100)) == 40


def test_held_out_style_is_evaluated_and_not_learnt():
    clips = [replace(swaying_clip(s, frames=12), style=s) for s in ("calm", "old", "young")]
    learnt, fixed = split_validation(clips, "old", 10)
    assert [c.name for c in learnt] == ["calm", "young"]
    assert [c.name for c in fixed] == ["old"]
    with pytest.raises(InputError, match="'angry'"):
        split_validation(clips, "angry", 10)
    with pytest.raises(InputError, match="no clips are left"):
        split_validation(clips, "calm,old,young", 10)


def swaying_clips() -> list[Clip]:
    return [swaying_clip(f"sway{i}", frames=40, height_m=1.6 + 0.1 * i) for i in range(3)]


@pytest.fixture
def clips(monkeypatch):
    found = swaying_clips()
    monkeypatch.setattr(training, "load_clips", lambda args: found)
    return found


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, str]:
    """A run with a teacher and a student, trained once for all tests, and what it printed."""
    out, printed = tmp_path_factory.mktemp("finished") / "run", io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
        patch.setattr(training, "load_clips", lambda args: swaying_clips())
        assert train(tiny(out)) == 0
    return out, printed.getvalue()


@pytest.fixture
def run_copy(finished, tmp_path) -> Path:
    """A copy of that run, to be continued."""
    return shutil.copytree(finished[0], tmp_path / "run")


def tiny(out: Path, **options) -> TrainArgs:
    return TrainArgs(
        **({"out": out, "preset": "smoke", "steps": 256, "envs": 8, "threads": 1} | options)
    )


def test_training_runs_its_stages_and_goes_on(clips, finished, run_copy):
    out = run_copy
    expected = PRESETS[tiny(out).preset].expect
    assert finished[1].startswith(f"preset {tiny(out).preset}: {expected}\n")
    record = yaml.safe_load((out / "run.yaml").read_text())
    assert record["format_version"] == 1
    assert record["args"]["seed"] == 0
    assert record["data"]["clips"] == 3
    assert len(record["data"]["sha256"]) == 64
    assert record["versions"]["torch"] == torch.__version__
    assert list((out / "teacher" / "tensorboard").iterdir())
    student = load_agent(out)
    assert isinstance(student, PolicyAgent)
    assert student.card["training"]["stage"] == "student"
    assert not student.needs.privileged
    assert train(tiny(out, resume=True, steps=512, stage="teacher")) == 0
    assert load_resume(out / "teacher" / "last")["learner"]["steps"] == 512
    assert load_resume(out / "student" / "last")["learner"]["steps"] == 256


def test_interrupted_training_ends_with_the_bits_of_one_that_was_not(clips, tmp_path):
    train(tiny(tmp_path / "whole", stage="teacher", steps=512))
    train(tiny(tmp_path / "parts", stage="teacher", steps=256))
    train(tiny(tmp_path / "parts", stage="teacher", steps=512, resume=True))
    whole, parts = (load_resume(tmp_path / run / "teacher" / "last") for run in ("whole", "parts"))
    assert whole["learner"]["steps"] == parts["learner"]["steps"] == 512
    for name, tensor in whole["learner"]["policy"].items():
        assert torch.equal(tensor, parts["learner"]["policy"][name]), name
    assert torch.equal(whole["env"]["physics"], parts["env"]["physics"])


def test_a_teacher_begins_with_another_teachers_weights_and_says_so(clips, tmp_path):
    train(tiny(tmp_path / "a", stage="teacher", seed=5))
    learnt = load_resume(tmp_path / "a" / "teacher" / "last")["learner"]["policy"]
    begun = tiny(
        tmp_path / "b", stage="teacher", start=tmp_path / "a" / "teacher" / "last", steps=64
    )
    train(begun)
    weights = load_resume(tmp_path / "b" / "teacher" / "last")["learner"]["policy"]
    for name, tensor in learnt.items():
        if "layers" in name:  # one update away from them, and far from the other seed's
            assert (tensor - weights[name]).abs().max() < 0.02, name
    parts = stages_behind(tmp_path / "b" / "teacher" / "best")
    assert [part.run.name for part in parts] == ["a", "b"]
    with pytest.raises(InputError, match="is not an agent"):
        train(replace(begun, out=tmp_path / "c", start=tmp_path / "none"))
    wider = "stages.teacher.policy.hidden=[64]"
    with pytest.raises(InputError, match="networks do not fit"):
        train(replace(begun, out=tmp_path / "d", set=(wider,)))
    (tmp_path / "a" / "teacher" / "last" / CRITIC_FILE).unlink()
    without = "stages.teacher.learning.critic_warmup_steps=0"
    with pytest.raises(InputError, match="has no critic"):
        train(replace(begun, out=tmp_path / "e", set=(*begun.set, without)))


def test_a_training_ends_with_the_command_that_scores_its_validation_motions(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "find_policy", lambda out: out / "best")
    plain = training._outcome(TrainArgs(tmp_path, validation="mine.toml:validation"))
    assert "--motions mine.toml:validation --out" in plain
    shown = TrainArgs(tmp_path, validation="mine.toml:validation", estimates="seen.npz")
    assert "--motions seen.npz --out" in training._outcome(shown)
    assert "--motions synthetic --out" in training._outcome(TrainArgs(tmp_path))


def test_a_full_body_student_of_teachers_becomes_a_teacher_with_a_new_critic(
    clips, finished, tmp_path
):
    full_body = (
        "actor_blocks=[o_sim,o_scale,privileged]",
        "reference_head=true",
        "balance=steps",
        "hidden=[8]",
    )
    changed = tuple(f"stages.student.policy.{value}" for value in full_body)
    train(tiny(tmp_path / "b", stage="student", teacher=finished[0], set=changed))
    started = tiny(tmp_path / "c", stage="teacher", start=tmp_path / "b" / "student" / "best")
    train(replace(started, set=(*started.set, "stages.teacher.policy.hidden=[8]")))
    assert (tmp_path / "c" / "teacher" / "last" / CRITIC_FILE).exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("threads", 0),
        ("envs", 0),
        ("steps", -5),
        ("minutes", -1.0),
        ("minutes", np.inf),
        ("seed", -1),
    ],
)
def test_numbers_out_of_range_are_refused_with_their_option(option, value, tmp_path):
    with pytest.raises(InputError, match=f"--{option}"):
        train(tiny(tmp_path / "run", **{option: value}))
    assert not (tmp_path / "run").exists()


def test_a_resume_is_noted_with_its_options(clips, run_copy):
    changed = "stages.teacher.learning.desired_kl=0.01"
    train(tiny(run_copy, stage="teacher", steps=512, resume=True, set=(changed,)))
    (again,) = yaml.safe_load((run_copy / "run.yaml").read_text())["resumed"]
    assert again["args"]["steps"] == 512
    assert again["preset"]["stages"]["teacher"]["learning"]["desired_kl"] == 0.01


def test_student_of_another_sensor_set_has_the_same_teacher(clips, finished, tmp_path):
    teacher = finished[0] / "teacher"
    options = {"stage": "student", "teacher": teacher, "sensors": "H", "future_frames": 0}
    assert train(tiny(tmp_path / "s", **options)) == 0
    agent = load_agent(tmp_path / "s")
    assert isinstance(agent, PolicyAgent)
    assert agent.policy.layout.sizes()["o_user"] == 9
    with pytest.raises(
        InputError, match=r"observes H with 0 future frames, the student H.2C with 6"
    ):
        train(tiny(tmp_path / "u", stage="student", teacher=tmp_path / "s"))


def test_fine_tuning_starts_from_the_student(clips, run_copy, monkeypatch):
    smoke = PRESETS["smoke"]
    student = smoke.stages["student"]
    finetune = replace(
        PRESETS["cpu"].stages["finetune"],
        policy=replace(student.policy, critic_blocks=(*SPARSE_BLOCKS, "privileged")),
        learning=PPOConfig(minibatch=64, critic_warmup_steps=10_000),
    )
    stages = smoke.stages | {"finetune": finetune}
    monkeypatch.setitem(training.PRESETS, "smoke", replace(smoke, stages=stages))
    out = run_copy
    train(tiny(out, resume=True, stage="finetune"))
    a, b = load_agent(out / "student" / "best"), load_agent(out / "finetune" / "last")
    assert isinstance(a, PolicyAgent)
    assert isinstance(b, PolicyAgent)
    for name, weight in a.policy.actor.layers.state_dict().items():
        # All of it was the critic's warm-up.
        assert torch.equal(weight, b.policy.actor.layers.state_dict()[name])


def test_run_folders_that_do_not_fit_are_refused(clips, tmp_path):
    out = tmp_path / "run"
    with pytest.raises(InputError, match="no run to resume"):
        train(tiny(out, resume=True))
    with pytest.raises(InputError, match="has no stage 'ppo'"):
        train(tiny(out, stage="ppo"))
    with pytest.raises(InputError, match="--teacher: does not go with --stage all"):
        train(tiny(out, teacher=Path("tracker")))
    with pytest.raises(InputError, match="has no teacher of its own; give --teacher"):
        train(tiny(out, stage="student"))
    assert not out.exists()
    train(tiny(out, stage="teacher", steps=128))
    with pytest.raises(InputError, match="holds a run already"):
        train(tiny(out))
    with pytest.raises(InputError, match="--seed was 0, not 1"):
        train(tiny(out, resume=True, seed=1))
    clips.pop()
    with pytest.raises(InputError, match="differ from those at the start of this run"):
        train(tiny(out, resume=True))
    record = yaml.safe_load((out / "run.yaml").read_text())
    (out / "run.yaml").write_text(yaml.safe_dump(record | {"format_version": 0}))
    with pytest.raises(InputError, match="format_version is 0"):
        train(tiny(out, resume=True))


def test_published_preset_is_as_published():
    paper = PRESETS["paper"]
    (stage,) = paper.stages.values()
    ppo = stage.learning
    assert isinstance(ppo, PPOConfig)
    assert (paper.num_envs, ppo.rollout_steps) == (4000, 15)
    assert ppo.rollout_steps * paper.num_envs == 4 * ppo.minibatch == 60_000
    assert (ppo.epochs, ppo.clip, ppo.gamma, ppo.gae_lambda) == (5, 0.2, 0.97, 0.95)
    assert (ppo.learning_rate, ppo.desired_kl) == (1e-4, None)
    assert stage.policy == PolicySpec(hidden=(400, 300, 200), activation="tanh", torque_head=False)
    assert (ppo.noise_legs_and_trunk, ppo.noise_arms_and_neck) == (0.03, 0.03)
    assert paper.body_preset == "paper"
    assert "privileged" not in stage.policy.actor_blocks + stage.policy.critic_blocks
