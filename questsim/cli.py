"""The command ``questsim``, and the error handling of every command line of the project.

This is the only module of ``questsim`` that names modules of ``agents``. It imports the module of a
subcommand when that subcommand runs, so that ``questsim --help`` does not load PyTorch.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from questsim import __version__
from questsim.errors import BAD_INPUT, INTERRUPTED, InputError, did_you_mean
from questsim.extensions import load_extensions
from questsim.lazy import imported
from questsim.modes import Modes
from questsim.parsing import parse
from questsim.processes import own_cores, processes


class Command(NamedTuple):
    """A subcommand.

    Attributes:
        args: ``"package.module:name"`` of its dataclass of options, or of its ``Modes``. Loading
            that module takes a fraction of a second, so that ``--help`` and errors come at once.
        function: the same of its function, which takes the options as its only argument; empty for
            a command with several modes.
        help: one line.
    """

    args: str
    function: str
    help: str


COMMANDS: dict[str, Command] = {
    "demo": Command(
        "agents.live.options:DemoArgs", "agents.live.demo:demo",
        "watch a policy follow a user: a page for the browser",
    ),
    "play": Command(
        "agents.live.options:PlayArgs", "agents.live.demo:play",
        "watch a training's newest policy, while it learns",
    ),
    "live": Command(
        "agents.headset.options:LiveArgs", "agents.headset.command:live",
        "put on a headset and be the avatar: a page for the headset's browser",
    ),
    "record": Command(
        "agents.headset.options:RecordArgs", "agents.headset.command:record",
        "like live, and write what the devices report to a file",
    ),
    "replay": Command(
        "agents.follower.options:ReplayArgs", "agents.follower.replay:replay",
        "let the avatar follow a recording of a headset and controllers",
    ),
    "recordings show": Command(
        "agents.follower.options:ShowRecordingArgs", "agents.follower.replay:show_recording",
        "summarise a recording, and plot its signals and foot contacts",
    ),
    "motions import": Command(
        "questsim.motion_options:ImportArgs", "agents.commands.import_motions:import_on_workers",
        "read BVH, ASF/AMC, AMASS and DeepMimic files into a library of clips",
    ),
    "motions mapping": Command(
        "questsim.motion_options:MappingArgs", "questsim.motion.motions_command:start_mapping",
        "write a draft of a mapping file for a skeleton that is not recognised",
    ),
    "motions fetch": Command(
        "questsim.motion_options:FetchArgs", "questsim.motion.motions_command:fetch_dataset",
        "download a public dataset and verify every clip of it",
    ),
    "motions vary": Command(
        "questsim.motion_options:VaryArgs", "agents.commands.vary:vary_motions",
        "write a library of variations of motions: other speeds, postures, stances, paths",
    ),
    "motions chain": Command(
        "questsim.motion_options:ChainArgs", "questsim.motion.motions_command:chain_motions",
        "write a library of chains: clips performed one after the other, with stands between",
    ),
    "motions export": Command(
        "questsim.motion_options:ExportMotionsArgs", "questsim.exporting.command:export_motions",
        "write motions as BVH, GLB, AMASS-style npz or CSV",
    ),
    "motions list": Command(
        "questsim.motion_options:ListMotionsArgs", "questsim.motion.motions_command:list_motions",
        "list the contents of a library, dataset, file or folder; alone, all datasets and kinds",
    ),
    "motions show": Command(
        "questsim.motion_options:ShowArgs", "questsim.viewing.show_command:show_clip",
        "draw a clip: a contact sheet and a video",
    ),
    "train": Command(
        "agents.commands.modes:TRAIN", "",
        "train an agent, or resume a training",
    ),
    "average": Command(
        "agents.policy.options:AverageArgs", "agents.policy.average:average_policies",
        "average the weights of policies that one training passed through",
    ),
    "sweep": Command(
        "agents.sweep.options:SweepArgs", "agents.sweep.command:sweep",
        "train several seeds and values of a preset, and compare them with intervals",
    ),
    "evaluate": Command(
        "agents.commands.modes:EVALUATE", "",
        "evaluate an agent on clips",
    ),
    "compare-runs": Command(
        "questsim.compare_runs_options:CompareRunsArgs",
        "questsim.compare_runs_command:compare_runs",
        "compare two evaluations clip by clip: intervals, clips that only one completes",
    ),
    "estimate": Command(
        "agents.kinematic.options:EstimateArgs", "agents.kinematic.estimate_command:estimate",
        "write a library of a kinematic system's estimates of motions",
    ),
    "envs": Command(
        "envs.list_command:ListEnvsArgs", "envs.list_command:list_environments",
        "list the environments and their options",
    ),
    "export": Command(
        "agents.policy.options:ExportArgs", "agents.policy.export:export",
        "write a policy as an ONNX graph from simulator state to torques",
    ),
    "agents": Command(
        "agents.shipping.options:AgentsArgs", "agents.shipping.catalogue:list_agents",
        "list every agent and preset: sensors, size, licence, weights",
    ),
    "ablations": Command(
        "agents.comparison.options:AblationsArgs", "agents.comparison.ablations:ablations",
        "train a kinematic system and variants without one part each, and compare them",
    ),
    "ship": Command(
        "agents.shipping.options:ShipArgs", "agents.shipping.ship:ship",
        "copy a trained policy to the shipped ones, with a card",
    ),
    "publish": Command(
        "agents.shipping.options:PublishArgs", "agents.shipping.publish:publish",
        "upload an agent with card and licence to the Hugging Face Hub",
    ),
}  # fmt: skip
QUICK = ("motions fetch", "motions list", "motions mapping", "envs", "agents")
"""Commands that load in about a second; the others say that they load something."""


def guarded(function: Callable[[], object]) -> int:
    """Run a command and print errors that the user can fix as one line on stderr.

    Args:
        function: the command; an int it returns is the exit code.

    Returns:
        The exit code: 0; 2 after an ``InputError`` or an ``OSError`` about a file, which are
        printed without a traceback; 130 after Ctrl-C. Anything else is a bug and is raised.
    """
    try:
        with processes(own_cores()):
            result = function()
        sys.stdout.flush()
    except InputError as error:
        return _refuse(str(error))
    except BrokenPipeError:
        # The reader of our output has closed the pipe, as in `questsim motions list ... | head`.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        return _refuse(f"{error.filename}: {error.strerror}")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    return result if isinstance(result, int) else 0


def run(command: Callable[[Any], object], args: type, argv: Sequence[str] | None = None) -> int:
    """Parse a dataclass of options and run a command with it, guarded.

    Args:
        command: the function, called with an instance of ``args``.
        args: a dataclass; its fields and their docstrings become the options and their help.
        argv: the arguments; by default those of the process.

    Returns:
        The exit code; see ``guarded``.
    """

    def parse_and_run() -> object:
        load_extensions()
        return command(parse(args, argv))

    return guarded(parse_and_run)


def run_modes(modes: Modes, argv: Sequence[str] | None = None) -> int:
    """Parse the command line of a command with several modes and run the chosen one, guarded.

    Args:
        modes: the modes.
        argv: the arguments; by default those of the process.

    Returns:
        The exit code; see ``guarded``.
    """

    def parse_and_run() -> object:
        load_extensions()
        return modes.run(sys.argv[1:] if argv is None else argv)

    return guarded(parse_and_run)


def usage() -> str:
    """The text of ``questsim --help``."""
    width = max(map(len, COMMANDS))
    lines = [f"  questsim {name:{width}}  {command.help}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            f"QuestSim {__version__}: a simulated avatar that follows a headset and controllers.",
            "",
            *lines,
            "",
            "questsim COMMAND --help lists the options of a command.",
        ]
    )


def main(argv: Sequence[str] | None = None) -> int:
    """The command ``questsim``; returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help"):
        print(usage())
        return 0 if words else BAD_INPUT
    if words[0] == "--version":
        print(f"questsim {__version__}")
        return 0
    for length in (2, 1):
        name = " ".join(words[:length])
        if name in COMMANDS:
            return _run_named(name, words[length:])
    family = [name for name in COMMANDS if name.startswith(words[0] + " ")]
    if family and words[1:] and words[1] in ("-h", "--help"):
        print("\n".join(f"questsim {name}: {COMMANDS[name].help}" for name in family))
        return 0
    known = family or list(COMMANDS)
    asked = " ".join([words[0], *(word for word in words[1:2] if not word.startswith("-"))])
    near = did_you_mean(asked, known) or did_you_mean(words[0], known)
    return _refuse(
        f"no command {asked!r}; {near}there are: {', '.join(known)}; try: questsim --help"
    )


def _run_named(name: str, argv: Sequence[str]) -> int:
    command = COMMANDS[name]
    # PyTorch threads that spin while waiting would slow down the physics threads.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

    def parse_and_run() -> object:
        load_extensions()
        options = imported(command.args)
        if isinstance(options, Modes):
            return options.run(argv, f"questsim {name}")
        args = parse(options, argv, f"questsim {name}", description=command.help)
        return imported(command.function, say=name not in QUICK)(args)

    return guarded(parse_and_run)


def _refuse(message: str) -> int:
    print("error: " + " ".join(message.split()), file=sys.stderr)
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
