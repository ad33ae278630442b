"""Kinematic systems on disk: a folder with weights and a description, like a policy's.

``system.safetensors`` holds networks and normalisers; ``system.yaml`` records agent, preset and
sizes. Neither can run code when loaded.
"""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import torch
import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import nn

from agents.kinematic.entry import Entry
from agents.kinematic.interface import KinematicSystem
from agents.kinematic.registry import AGENTS
from agents.kinematic.switches import switches
from agents.policy.checkpoint import write_resume
from agents.resolve import IK, SYSTEM_CARD, Resolved, own_object, resolve_system
from questsim.errors import InputError
from questsim.extensions import load_extensions
from questsim.files import read_yaml, whole_folder
from questsim.joint_sensors import SENSOR_FPS
from questsim.skeleton import JOINTS

MAX_SIZE, MAX_DEPTH, MAX_LIST = 4096, 64, 16
"""Largest numbers in a description of networks: of units, of layers, of items in a list."""
KINDS = {int: "a whole number", bool: "true or false", str: "a name"}
FORMAT, FORMAT_VERSION = "questsim-kinematic", 1
WEIGHTS_FILE, CARD_FILE = "system.safetensors", SYSTEM_CARD


def save_system(
    folder: Path,
    module: nn.Module,
    agent: str,
    spec: Any,
    training: dict[str, Any],
    resume: dict[str, Any] | None = None,
) -> None:
    """Write a checkpoint folder; an older one is replaced only by a complete new one.

    Args:
        folder: the folder.
        module: the agent's networks.
        agent: its name in the registry.
        spec: its sizes.
        training: training record; ``trained`` lists the stages that are finished or in progress.
        resume: state for resuming.
    """
    card = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "agent": agent,
        "fps": SENSOR_FPS,
        "joints": list(JOINTS),
        "spec": _plain(asdict(spec)),
        "training": training,
    }
    weights = {name: tensor.detach().contiguous() for name, tensor in module.state_dict().items()}
    with whole_folder(folder) as fresh:
        (fresh / WEIGHTS_FILE).write_bytes(save(weights))
        (fresh / CARD_FILE).write_text(yaml.safe_dump(card, sort_keys=False), encoding="utf-8")
        if resume is not None:
            write_resume(fresh, resume)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def read_system_card(folder: Path) -> dict[str, Any]:
    """The checked ``system.yaml`` of a folder.

    Raises:
        InputError: it is missing, not YAML, of another format version, of an unknown agent, or
            made for other joints or another frame rate.
    """
    path = folder / CARD_FILE
    try:
        card = read_yaml(path, "description of a system")
    except FileNotFoundError:
        raise InputError(f"there is no {CARD_FILE}", folder) from None
    if card.get("format") != FORMAT:
        raise InputError(f"is not of format {FORMAT!r}", path)
    expected = {"format_version": FORMAT_VERSION, "fps": SENSOR_FPS, "joints": list(JOINTS)}
    for field, value in expected.items():
        if card.get(field) != value:
            raise InputError(f"{field} is not {value!r}", path, "train it again")
    if card.get("agent") not in AGENTS:
        load_extensions()
    if card.get("agent") not in AGENTS:
        what = f"agent {card.get('agent')!r} is not a known family"
        raise InputError(what, path, f"it is one of {', '.join(AGENTS)}")
    training = card.get("training")
    trained = training.get("trained", []) if isinstance(training, dict) else None
    if not isinstance(trained, list) or not all(isinstance(name, str) for name in trained):
        raise InputError("training has no list 'trained' of names", path, "train it again")
    return card


def load_module(folder: Path) -> tuple[nn.Module, dict[str, Any]]:
    """Networks of a checkpoint folder, and its card.

    Raises:
        InputError: see ``read_system_card``; or the weights are damaged or do not fit.
    """
    card = read_system_card(folder)
    entry = AGENTS[card["agent"]]
    spec = _spec(entry, card, folder)
    module = _built(entry, spec, folder / CARD_FILE)
    try:
        module.load_state_dict(load_file(folder / WEIGHTS_FILE))
    except FileNotFoundError:
        raise InputError(f"there is no {WEIGHTS_FILE}", folder) from None
    except (SafetensorError, RuntimeError) as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise InputError(f"the weights do not fit ({reason})", folder / WEIGHTS_FILE) from error
    for name, tensor in module.state_dict().items():
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise InputError(f"{name} is not finite", folder / WEIGHTS_FILE)
    return module, card


def _spec(entry: Entry, card: dict[str, Any], folder: Path) -> Any:
    kind = type(entry.presets["paper"].spec)
    found = card.get("spec")
    known = {field.name for field in fields(kind)}
    if not isinstance(found, dict) or not known - switches(kind) <= set(found) <= known:
        raise InputError(
            "the description of the networks is incomplete", folder / CARD_FILE, "train it again"
        )
    usual = asdict(entry.presets["paper"].spec)
    for name, value in found.items():
        _check_value(name, value, usual[name], folder / CARD_FILE)
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in found.items()})


def _check_value(name: str, value: Any, usual: Any, path: Path) -> None:
    """Refuse a value of another type than the published one, or beyond any network's size."""
    if isinstance(usual, tuple | list):
        if not isinstance(value, list) or len(value) > MAX_LIST:
            raise InputError(f"spec.{name} is not a list of at most {MAX_LIST}", path)
        for item in value:
            _check_value(name, item, usual[0], path)
        return
    kind = "a number" if isinstance(usual, float) else KINDS[type(usual)]
    if isinstance(usual, float) and type(value) is int:
        value = float(value)
    if type(value) is not type(usual) or value != value:
        raise InputError(f"spec.{name} is not {kind}", path)
    most = MAX_DEPTH if "layers" in name or name == "blocks" else MAX_SIZE
    if not isinstance(value, str) and not 0 <= value <= most:
        raise InputError(f"spec.{name} is not within 0-{most}", path)


def _built(entry: Entry, spec: Any, path: Path) -> nn.Module:
    try:
        return entry.build(spec)
    except InputError:
        raise
    except Exception as error:  # a layer's constructor objects to the sizes, in its own way
        reason = (str(error).strip() or type(error).__name__).splitlines()[0][:150]
        raise InputError(f"these networks cannot be built ({reason})", path) from error


def find_system(path_or_name: str | Path) -> Path:
    """The checkpoint folder of a kinematic system given by path, stage, run or name.

    Raises:
        InputError: no such system, or it has no checkpoint.
    """
    folder = resolve_system(path_or_name).folder
    if folder is None:
        raise InputError("has no weights", path_or_name, "name a trained system")
    return folder


def load_system(path_or_name: str | Path | Resolved, **options: Any) -> KinematicSystem:
    """A kinematic system by name, checkpoint or run folder, or ``package.module:Class``.

    Args:
        path_or_name: the system to load.
        **options: options of the system, e.g. ``future_frames`` of SparsePoser, ``iterations`` of
            DragPoser.

    Raises:
        InputError: no such system, or its checkpoint cannot be used.
    """
    found = resolve_system(path_or_name)
    if found.name == IK:
        from agents.kinematic.ik import InverseKinematics

        return InverseKinematics(**options)
    if found.folder is None:
        return own_object(found.name)
    module, card = load_module(found.folder)
    entry = AGENTS[card["agent"]]
    system = entry.system(module, found.name, card["training"].get("trained", []), options)
    system.scenarios = entry.scenarios
    return system
