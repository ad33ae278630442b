"""Export a policy as one ONNX graph, from raw simulator state and device poses to torques (N m)."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import logging
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor, nn

from agents.agent import Agent
from agents.licence import licence_of
from agents.policy.checkpoint import find_policy, load_policy
from agents.policy.networks import TorquePolicy, with_head
from agents.policy.observation_module import SparseObservation
from agents.policy.options import ExportArgs
from agents.policy.policy_agent import PolicyAgent
from agents.policy.spec import SPARSE_BLOCKS
from envs.config import EnvConfig
from envs.layout import observation_layout
from questsim import __version__
from questsim.body import DEFAULT_HEIGHT_M, MAX_HEIGHT_M, MIN_HEIGHT_M, PRESETS, build_body
from questsim.errors import InputError
from questsim.motion.clip import FPS
from questsim.sensors import sensor_set
from questsim.skeleton import DOFS, FEET, LINKS

FORMAT, FORMAT_VERSION = "questsim-onnx", 1
OPSET = 20
NEEDED_PACKAGES = ("onnx", "onnxscript")


class TorqueController(nn.Module):
    """Observation, normalisation, policy and the body's torque limits in one module.

    Args:
        policy: reads only the sparse blocks, with the columns of ``observation``.
        observation: computes the policy's observation.
        body_preset: name of the preset whose torque limits scale with height.
    """

    torque_limits: Tensor

    def __init__(
        self, policy: TorquePolicy, observation: SparseObservation, body_preset: str
    ) -> None:
        super().__init__()
        # Only the parts that acting needs: critic and optimiser stay out of the graph.
        self.actor, self.head, self.observation = policy.actor, policy.head, observation
        limits = build_body(DEFAULT_HEIGHT_M, body_preset).torque_limits
        self.register_buffer("torque_limits", torch.as_tensor(limits, dtype=torch.float32))
        self.torque_power = PRESETS[body_preset].torque_power

    def forward(self, *state: Tensor) -> Tensor:
        """Torques ``(n, 33)`` in N m for the arguments of ``SparseObservation.forward``.

        Heights are clamped to those that bodies have. An avatar with a number that is not finite,
        such as of a device that has lost tracking, gets no torques.
        """
        whole = torch.stack([torch.isfinite(part).flatten(1).all(dim=1) for part in state])
        finite = whole.all(dim=0)[:, None]
        state = tuple(torch.where(torch.isfinite(part), part, 0.0) for part in state)
        height_m = state[-1].clamp(MIN_HEIGHT_M, MAX_HEIGHT_M)
        obs = self.observation(*state[:-1], height_m)
        terms = () if self.head is None else self.head.terms(obs)
        action = with_head(self.actor(obs), self.head, terms)
        strength = (height_m / DEFAULT_HEIGHT_M) ** self.torque_power
        torques = action.clamp(-1.0, 1.0) * self.torque_limits * strength
        return torch.where(finite, torques, 0.0)


def export(args: ExportArgs) -> int:
    """Write the graph that ``args`` requests; returns the exit code.

    Raises:
        InputError: the agent cannot be exported, the file cannot be written, or packages are
            missing.
    """
    agent = load_policy(find_policy(args.agent))
    check_exportable(agent, args.agent)
    _check_packages()
    if args.out.is_dir() or not args.out.parent.is_dir():
        raise InputError("cannot be written", args.out, "name a file in an existing folder")
    write_onnx(agent, args.out)
    print(f"written to {args.out} ({args.out.stat().st_size / 1e6:.1f} MB)")
    return 0


def check_exportable(agent: Agent, where: str | None = None) -> None:
    """Refuse an agent whose inputs are not simulator state and device poses.

    Args:
        agent: any agent.
        where: the user's name for it, for the message; by default its own name.

    Raises:
        InputError: names its kind or the input that is not available.
    """
    where = where or agent.name
    if not isinstance(agent, PolicyAgent):
        raise InputError("is not a trained policy", where)
    if agent.needs.body is not None:
        body = agent.needs.body.name
        raise InputError(f"was trained for the body {body!r}", where, "export one for our avatar")
    spec = agent.policy.spec
    others = [name for name in spec.actor_blocks if name not in SPARSE_BLOCKS]
    if others or spec.reference_head:
        read = ", ".join(others) or "the reference pose"
        raise InputError(
            f"reads {read}, which no device measures", where, "export one of its students"
        )
    if agent.needs.observe_proportions:
        what = "observes the avatar's proportions, which the graph does not take"
        raise InputError(what, where, "export a policy trained without --observe-proportions")


def controller_of(agent: PolicyAgent) -> TorqueController:
    """The module that an export holds.

    Raises:
        InputError: see ``check_exportable``; or the policy was made for another observation.
    """
    check_exportable(agent)
    needs = agent.needs
    config = EnvConfig(
        sensors=needs.sensors, future_frames=needs.future_frames, body_preset=needs.body_preset
    )
    agent.bind(SimpleNamespace(layout=observation_layout(config), config=config))
    observation = SparseObservation(len(config.frame_offsets), len(sensor_set(needs.sensors)))
    return TorqueController(agent.policy, observation, needs.body_preset).eval()


def write_onnx(agent: Agent, out: Path) -> None:
    """Write an agent's graph; an older file is replaced only by a complete new one.

    Args:
        agent: a trained policy on sparse observations.
        out: the file.

    Raises:
        InputError: see ``controller_of``.
    """
    import onnx

    assert isinstance(agent, PolicyAgent)
    model = _graph(controller_of(agent))
    for key, value in metadata(agent).items():
        model.metadata_props.add(key=key, value=value)
    onnx.checker.check_model(model, full_check=True)
    fresh = out.with_name(out.name + ".new")
    fresh.write_bytes(model.SerializeToString())
    fresh.replace(out)


def metadata(agent: PolicyAgent) -> dict[str, str]:
    """Metadata of the file; lists are separated by commas, in the order of the arrays."""
    needs = agent.needs
    offsets = EnvConfig(future_frames=needs.future_frames).frame_offsets
    return {
        "format": FORMAT,
        "format_version": str(FORMAT_VERSION),
        "questsim_version": __version__,
        "policy": agent.name,
        "licence": licence_of(agent.card.get("training", {})),
        "fps": f"{FPS:g}",
        "dofs": ",".join(DOFS),
        "links": ",".join(LINKS),
        "feet": ",".join(FEET),
        "sensors": needs.sensors,
        "devices": ",".join(sensor_set(needs.sensors)),
        "frame_offsets": ",".join(map(str, offsets)),
        "body_preset": needs.body_preset,
        "height_range_m": f"{MIN_HEIGHT_M:g},{MAX_HEIGHT_M:g}",
        "conventions": "metres, radians, seconds, newtons; z up, floor at z = 0; quaternions wxyz",
    }


def _graph(controller: TorqueController) -> Any:
    """The module as an ONNX model, without information about the exporting machine."""
    names = controller.observation.shapes()
    # Two rows: torch treats an axis of length one as constant.
    example = tuple(torch.zeros(2, *shape) for shape in names.values())
    rows = torch.export.Dim("n")
    with _quiet(), torch.no_grad():
        program = torch.onnx.export(
            controller,
            example,
            input_names=list(names),
            output_names=["torque"],
            opset_version=OPSET,
            dynamic_shapes=(tuple({0: rows} for _ in example),),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    graph = model.graph
    for part in (*graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer):
        # The exporter stores source lines with absolute paths.
        del part.metadata_props[:]
        part.doc_string = ""
    del graph.metadata_props[:]
    graph.name = FORMAT
    return model


@contextlib.contextmanager
def _quiet() -> Any:
    """Suppress the exporter's messages, which do not help the user."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _check_packages() -> None:
    missing = [name for name in NEEDED_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            f"export to ONNX needs the packages {', '.join(missing)}",
            fix="pip install 'questsim[export]'",
        )
