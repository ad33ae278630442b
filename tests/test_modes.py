"""Each job of a command refuses the options of the others, by name and with exit code 2."""

from itertools import product

import pytest

from agents.commands.modes import EVALUATE, TRAIN
from agents.evaluation import EvaluateArgs, evaluate
from agents.training.options import TrainArgs
from agents.training.train_policy import train
from questsim.cli import main, run_modes
from questsim.errors import InputError
from questsim.modes import Modes, option_names
from questsim.parsing import parse

COMMANDS = {
    "evaluate": (EVALUATE, {
        "--agent NAME": [], "--worlds": ["--worlds"], "--scorecard": ["--scorecard"],
        "--compare": ["--compare"], "--by-group": ["--by-group"],
    }),
    "train": (TRAIN, {"--agent policy": [], "--agent SYSTEM": ["--agent", "lgsik"]}),
}  # fmt: skip


def pairs() -> list[tuple[str, str, str]]:
    """Command, mode and option of every option that a mode does not have."""
    found = []
    for command, (modes, _) in COMMANDS.items():
        for mode, other in product(modes.modes, modes.modes):
            foreign = other.options() - mode.options()
            foreign -= {"--agent"} if command == "train" else set()  # it chooses the mode
            found += [(command, mode.name, option) for option in sorted(foreign)]
    return sorted(set(found))


def test_there_are_many_pairs_of_mode_and_foreign_option():
    assert len(pairs()) > 40
    assert ("evaluate", "--compare", "--terrain") in pairs()
    systems = TRAIN.modes[1].name
    assert ("train", systems, "--sensors") in pairs()
    nested = {option for _, mode, option in pairs() if mode == systems and "." in option}
    assert {option.partition(".")[0] for option in nested} == {"--randomisation", "--starts"}


@pytest.mark.parametrize(("command", "mode", "option"), pairs())
def test_a_foreign_option_is_refused_by_name(command, mode, option, capsys):
    modes, words = COMMANDS[command]
    for written in (option, option.replace("-", "_").replace("__", "--", 1), f"{option}=1"):
        assert run_modes(modes, [*words[mode], written]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"error: {option}: does not go with {mode}")
        assert error.count("\n") == 1


def test_the_modes_of_an_evaluation_do_not_go_together(capsys):
    assert run_modes(EVALUATE, ["--compare", "--agents", "ik", "--worlds"]) == 2
    assert "--compare: does not go with --worlds" in capsys.readouterr().err


def test_the_command_that_ignored_five_options_refuses_the_first(capsys):
    words = "--compare --agents ik --terrain nonsense --height 9 --scorecard --worlds --env nope"
    assert main(["evaluate", *words.split()]) == 2
    assert "--compare: does not go with --scorecard" in capsys.readouterr().err
    words = "--compare --agents ik --terrain nonsense --height 9 --env nope"
    assert main(["evaluate", *words.split()]) == 2
    assert "--terrain: does not go with --compare" in capsys.readouterr().err


def test_an_unknown_agent_to_train_is_refused_with_what_there_is(capsys):
    assert run_modes(TRAIN, ["--agent", "nobody", "--out", "nowhere"]) == 2
    assert "use one of policy, avatarposer, hmdposer" in capsys.readouterr().err


@pytest.mark.parametrize("written", [["--agent", "lgsik"], ["--agent=lgsik"]])
def test_the_family_of_a_training_may_be_written_either_way(written):
    mode, words = TRAIN.chosen([*written, "--out", "x"])
    assert mode is TRAIN.modes[1] and words == ["--agent", "lgsik", "--out", "x"]


@pytest.mark.parametrize("modes", [EVALUATE, TRAIN])
def test_every_mode_explains_itself_and_names_the_others(modes: Modes, capsys):
    for words in next(w for m, w in COMMANDS.values() if m is modes).values():
        with pytest.raises(SystemExit) as end:
            modes.run([*words, "--help-all"])
        assert end.value.code == 0
        assert "For other options" in capsys.readouterr().out


@pytest.mark.parametrize("modes", [EVALUATE, TRAIN])
def test_the_first_page_of_help_has_every_option_once_and_fits_a_screen(modes: Modes, capsys):
    assert modes.run(["--help"], "questsim x") == 0
    page = capsys.readouterr().out
    assert page.count("\n") < 45 and max(map(len, page.splitlines())) <= 88
    mode = modes.modes[0]
    assert mode.help is not None
    on_page = mode.help.names()
    options = {option.removeprefix("--").partition(".")[0] for option in mode.options()}
    options = {name for name in options if not name.startswith("no-")} | {"agent"}
    jobs = {other.name.removeprefix("--") for other in modes.modes[1:] if " " not in other.name}
    assert sorted(name.removesuffix(".*") for name in on_page) == sorted(options | jobs)


def test_the_examples_of_the_first_page_can_be_parsed():
    for modes in (EVALUATE, TRAIN):
        page = modes.modes[0].help
        assert page is not None
        for words, _ in page.examples:
            mode, rest = modes.chosen(words.split())
            parse(mode.args, rest)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--threads x", "--threads: is 'x', not a whole number; see"),
        ("--heights 1.4", "--heights: is '1.4', not two numbers; see"),
        ("--preset q", "--preset: is 'q'; choose from cpu, paper, smoke"),
        ("--minute 3", "there is no option --minute; did you mean --minutes? see"),
        ("--motion m --minuts 3", "there is no option --motion; did you mean --motions? see"),
        ("--resume yes", "unexpected 'yes': it belongs to no option; see"),
        ("--stage", "--stage: needs a value; see"),
        ("--randomisation.noise-m 0.2 0.1", "randomisation: noise_m is (0.2, 0.1), not a range"),
    ],
)
def test_a_word_that_train_cannot_read_is_one_line_that_names_the_option(words, expected, capsys):
    assert run_modes(TRAIN, ["--out", "x", *words.split()]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {expected}") and error.count("\n") == 1


def test_a_required_option_that_is_missing_is_named(capsys):
    assert main(["play"]) == 2
    assert capsys.readouterr().err.startswith("error: missing: PATH (A run folder, a stage in it")


@pytest.mark.parametrize("agent", ["ik", "ik+physics"])
@pytest.mark.parametrize(
    "given",
    [
        {"env": "QuestSimRough-v0"},
        {"height": 1.8},
        {"terrain": "rough"},
        {"objects": ("ball",)},
    ],
)
def test_a_kinematic_system_refuses_the_options_of_an_environment(agent, given, tmp_path):
    option = "--" + next(iter(given)).replace("_", "-")
    with pytest.raises(InputError, match=f"{option}: does not go with {agent[:2]}"):
        evaluate(EvaluateArgs(agent, out=tmp_path / "out", **given))
    assert not (tmp_path / "out").exists()


def test_a_policy_refuses_the_devices_of_a_kinematic_system():
    with pytest.raises(InputError, match="--sensors: does not go with zero"):
        evaluate(EvaluateArgs("zero", sensors="H"))


@pytest.mark.parametrize(
    ("option", "options"),
    [
        ("teacher", {"stage": "teacher"}),
        ("teacher", {"stage": "finetune"}),
        ("teacher", {"preset": "paper"}),
        ("start", {"preset": "paper"}),
        ("start", {"preset": "paper", "stage": "ppo"}),
    ],
)
def test_a_training_refuses_a_policy_that_no_stage_builds_on(option, options, tmp_path):
    args = TrainArgs(tmp_path / "run", **{option: tmp_path}, **options)
    name, value = list(options.items())[-1]
    with pytest.raises(InputError, match=f"--{option}: does not go with --{name} {value}"):
        train(args)
    assert not (tmp_path / "run").exists()


def test_options_of_nested_dataclasses_are_known():
    names = option_names(TrainArgs)
    assert {"--out", "--hold-out", "--mirrored", "--no-mirrored", "--future-frames"} <= names
    assert any(name.startswith("--randomisation.") for name in names)
