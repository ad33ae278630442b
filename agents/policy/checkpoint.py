"""Policies on disk: a folder with weights, a description and a resume file.

``policy.safetensors`` holds the actor with its normaliser, gains and noise; ``policy.yaml``
describes the observation, joints, links and body that it fits. Neither can run code when loaded.
``critic.safetensors`` is used only for further training, not for acting. ``resume.pt``, in the last
checkpoint of a training, holds the state for resuming.
"""

from __future__ import annotations

import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save

from agents.agent import Needs
from agents.policy.networks import TorquePolicy
from agents.policy.policy_agent import PolicyAgent, Tracker, new_policy
from agents.policy.spec import TRACKER_BLOCKS, Layout, PolicySpec
from agents.resolve import POLICY_CARD, resolve_policy
from envs.avatar import avatar_of
from questsim.bodies import OwnBody
from questsim.errors import InputError
from questsim.files import read_yaml, whole_folder
from questsim.motion.clip import FPS
from questsim.skeleton import DOFS, LINKS

FORMAT, FORMAT_VERSION = "questsim-policy", 1
WEIGHTS_FILE, CARD_FILE, RESUME_FILE = "policy.safetensors", POLICY_CARD, "resume.pt"
CRITIC_FILE = "critic.safetensors"
CRITIC = "critic."
_LATER = ("body", "observe_proportions")
"""Needs that a description has only where they are used: earlier ones have none."""
SAME_PRESET = "use the --preset and --set of its training"
LARGEST = 65_536
"""Inputs or outputs of a layer."""


def save_policy(
    folder: Path,
    policy: TorquePolicy,
    needs: Needs,
    training: dict[str, Any],
    resume: dict[str, Any] | None = None,
) -> None:
    """Write a checkpoint folder; an older one is replaced only by a complete new one.

    Args:
        folder: the folder; its parent is created.
        policy: its actor and, if it has one, its critic are saved.
        needs: the environment it acts in.
        training: training record: data, licence, steps, figures.
        resume: state for resuming: tensors, arrays, numbers, text, lists and dictionaries.
    """
    state = {name: tensor.detach().contiguous() for name, tensor in policy.state_dict().items()}
    critic = {name: state.pop(name) for name in list(state) if name.startswith(CRITIC)}
    card = describe(policy, needs) | {"training": training}
    with whole_folder(folder) as fresh:
        (fresh / WEIGHTS_FILE).write_bytes(save(state))
        if critic:
            (fresh / CRITIC_FILE).write_bytes(save(critic))
        (fresh / CARD_FILE).write_text(yaml.safe_dump(card, sort_keys=False), encoding="utf-8")
        if resume is not None:
            write_resume(fresh, resume)


def describe(policy: TorquePolicy, needs: Needs) -> dict[str, Any]:
    """The contents of ``policy.yaml`` without the training record."""
    spec = asdict(policy.spec)
    del spec["critic_blocks"]
    layout, avatar = policy.layout.within(policy.spec.read_blocks), avatar_of(needs.body)
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "fps": FPS,
        "joints": list(avatar.dofs),
        "links": list(avatar.links),
        "needs": {k: v for k, v in asdict(needs).items() if k not in _LATER or v},
        "network": {k: list(v) if isinstance(v, tuple) else v for k, v in spec.items()},
        "observation": {name: list(block) for name, block in layout.blocks.items()},
    }


def read_card(folder: Path) -> dict[str, Any]:
    """The checked ``policy.yaml`` of a checkpoint folder.

    Raises:
        InputError: it is missing, not YAML, of another format version, or made for other joints,
            links or another frame rate.
    """
    path = folder / CARD_FILE
    try:
        card = read_yaml(path, "policy description")
    except FileNotFoundError:
        raise InputError(f"there is no {CARD_FILE}", folder, "name a policy folder") from None
    if card.get("format") != FORMAT:
        raise InputError(f"is not of format {FORMAT!r}", path)
    expected = {
        "format_version": FORMAT_VERSION,
        "joints": list(DOFS),
        "links": list(LINKS),
        "fps": FPS,
    }
    if _own_body(card, path) is not None:  # compared with the environment's when it is bound
        del expected["joints"], expected["links"]
    for field, value in expected.items():
        if card.get(field) != value:
            raise InputError(_difference(field, card.get(field), value), path, "train it again")
    return card


def _own_body(card: dict[str, Any], path: Path) -> OwnBody | None:
    """The body of a policy for a body of the user's own."""
    needs = card.get("needs")
    body = needs.get("body") if isinstance(needs, dict) else None
    if body is None:
        return None
    fields = {"name", "path", "digest"}
    if not isinstance(body, dict) or set(body) != fields:
        raise InputError("needs.body is not name, path and digest", path, "train it again")
    if not all(isinstance(value, str) for value in body.values()):
        raise InputError("a field of needs.body is not text", path, "train it again")
    for field in ("joints", "links"):
        names = card.get(field)
        if not isinstance(names, list) or not 0 < len(names) <= LARGEST:
            raise InputError(f"{field} is not a list of names", path, "train it again")
    return OwnBody(**body)


def _difference(field: str, found: Any, expected: Any) -> str:
    """A message about a field whose value this version of the code cannot use."""
    if isinstance(expected, list):
        found = found if isinstance(found, list) else []
        if len(found) != len(expected):
            return f"{field} has {len(found)} names instead of {len(expected)}"
        i = next(i for i, name in enumerate(expected) if found[i] != name)
        return f"{field} has {found[i]!r} in the place of {expected[i]!r} (number {i})"
    return f"{field} is {found!r}, this version reads {expected!r}"


def needs_of(folder: Path) -> Needs:
    """What the policy of a checkpoint folder needs of its environment; its weights are not read.

    Raises:
        InputError: see ``read_card``; or the description is incomplete.
    """
    card = read_card(folder)
    try:
        return _needs(card, folder / CARD_FILE)
    except (KeyError, TypeError) as error:
        raise _incomplete(error, folder) from error


def _needs(card: dict[str, Any], path: Path) -> Needs:
    return Needs(**{**card["needs"], "body": _own_body(card, path)})


def _incomplete(error: Exception, folder: Path) -> InputError:
    return InputError(f"the description is incomplete ({error})", folder / CARD_FILE)


def load_policy(folder: Path) -> PolicyAgent:
    """The agent of a checkpoint folder.

    Raises:
        InputError: see ``read_card``; or the weights are damaged or do not fit the description.
    """
    card = read_card(folder)
    try:
        network: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in card["network"].items()
        }
        spec = PolicySpec(**network, critic_blocks=())
        check_sizes("hidden", spec.hidden)
        blocks = {name: (int(a), int(b)) for name, (a, b) in card["observation"].items()}
        check_sizes("observation", (1, *(b for _, b in blocks.values())))
        if any(not 0 <= a < b for a, b in blocks.values()):
            raise ValueError("a block of the observation is empty")
        needs = _needs(card, folder / CARD_FILE)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _incomplete(error, folder) from error
    policy = new_policy(spec, Layout(blocks), hinges=len(card["joints"]))
    try:
        policy.load_state_dict(load_file(folder / WEIGHTS_FILE))
    except FileNotFoundError:
        raise InputError(f"there is no {WEIGHTS_FILE}", folder) from None
    except (SafetensorError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise InputError(f"the weights do not fit ({reason})", folder / WEIGHTS_FILE) from error
    for name, tensor in policy.state_dict().items():
        if not bool(torch.isfinite(tensor).all()):
            raise InputError(f"{name} is not finite", folder / WEIGHTS_FILE)
    kind = Tracker if spec.actor_blocks == TRACKER_BLOCKS else PolicyAgent
    return kind(policy, needs, folder.name, card)


def check_sizes(name: str, sizes: tuple[Any, ...]) -> None:
    """Refuse invalid network sizes before any network is created.

    Raises:
        ValueError: names the first invalid size.
    """
    for size in sizes:
        if isinstance(size, bool) or not isinstance(size, int) or not 1 <= size <= LARGEST:
            raise ValueError(f"{name} has {str(size)[:20]}, not 1 to {LARGEST}")


def has_critic(folder: Path) -> bool:
    """Whether a critic was saved with the policy of a checkpoint folder."""
    return (folder / CRITIC_FILE).exists()


def load_critic(folder: Path, policy: TorquePolicy) -> None:
    """Load the critic saved with a policy into ``policy``.

    Raises:
        InputError: it is damaged or has another shape.
    """
    path = folder / CRITIC_FILE
    try:
        critic = load_file(path)
        missing, unexpected = policy.load_state_dict(critic, strict=False)
    except (SafetensorError, RuntimeError) as error:
        raise InputError("its critic does not fit this preset's", path, SAME_PRESET) from error
    if unexpected or any(name.startswith(CRITIC) for name in missing):
        raise InputError("its critic does not fit this preset's", path, SAME_PRESET)


def find_policy(path_or_name: str | Path) -> Path:
    """The checkpoint folder of a policy given by path, stage folder, run folder or name.

    Raises:
        InputError: no such policy; the message lists the known ones.
    """
    folder = resolve_policy(path_or_name).folder
    assert folder is not None
    return folder


def find_teacher(path_or_name: str | Path) -> Path:
    """Like ``find_policy``, but finds the teacher of a run.

    Raises:
        InputError: see ``find_policy``.
    """
    teacher = Path(path_or_name) / "teacher"
    return find_policy(teacher if teacher.is_dir() else path_or_name)


def write_resume(folder: Path, state: dict[str, Any]) -> None:
    """Write the state for resuming; see ``load_resume``.

    Raises:
        OSError: it cannot be written, e.g. the disk is full (torch itself raises another type).
    """
    memory = io.BytesIO()
    torch.save(pack(state), memory)
    (folder / RESUME_FILE).write_bytes(memory.getbuffer())


def load_resume(folder: Path) -> dict[str, Any]:
    """The state passed to ``save_policy`` as ``resume``.

    Raises:
        InputError: the file is missing or damaged.
    """
    path = folder / RESUME_FILE
    if not path.exists():
        raise InputError("there is nothing to resume", folder, "leave out --resume")
    try:
        return torch.load(path, weights_only=True)
    except Exception as error:  # torch raises many exception types for a damaged file
        raise InputError("the resume file is damaged", path) from error


def pack(value: Any) -> Any:
    """Convert arrays in a state to tensors, since resume files hold only tensors."""
    if isinstance(value, dict):
        return {key: pack(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [pack(item) for item in value]
    if isinstance(value, np.ndarray):
        return torch.as_tensor(value.copy())
    return value.item() if isinstance(value, np.generic) else value


def unpack(value: Any) -> Any:
    """The inverse of ``pack``: the state with arrays as arrays."""
    if isinstance(value, dict):
        return {key: unpack(item) for key, item in value.items()}
    if isinstance(value, list):
        return [unpack(item) for item in value]
    return value.numpy() if isinstance(value, torch.Tensor) else value
