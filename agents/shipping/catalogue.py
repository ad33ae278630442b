"""``questsim agents``: list every agent and preset with sensors, size and shipped weights."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

from agents.licence import licence_of, strictest
from agents.resolve import (
    ESTIMATE_TRACKER,
    SHIPPED,
    SYSTEM_CARD,
    UNTRAINED,
    resolve,
    shipped_policies,
    with_physics,
)
from agents.shipping.options import AgentsArgs
from questsim.licences import OURS

_REGISTRY = "agents.kinematic.registry"
_STATISTICS = (".norm.mean", ".norm.var", ".norm.count")
"""Ends of the names of a policy's tensors that are not trained."""


def catalogue() -> list[dict[str, Any]]:
    """One entry per agent and preset.

    Keys: ``agent``, ``preset``, ``title``, ``sensors``, ``parameters``, ``licence``, ``weights``.
    ``sensors`` are the sets of devices that it can use, or ``reference`` if it observes the whole
    body of a reference motion instead. ``parameters`` counts trainable parameters. ``licence`` is
    that of the weights, or of the code if there are no weights. ``weights`` says whether weights
    are shipped. Everything is read from descriptions; no network is built or loaded.
    """
    shipped = [
        (folder.parent.name, resolve(folder.parent).card)
        for folder in sorted(SHIPPED.glob(f"*/{SYSTEM_CARD}"))
    ]
    entries = []
    for family in _families():
        there = [
            (name, card)
            for name, card in shipped
            if card["agent"] == family["agent"]
            and card["training"].get("preset") == family["preset"]
        ]
        own = [card for name, card in there if name == family["agent"]]
        licence = licence_of(own[0]["training"]) if own else OURS
        entries.append(family | {"licence": licence, "weights": bool(own)})
        # Weights of the same system under another name, e.g. trained with another loss.
        entries += [
            family | {"agent": name, "licence": licence_of(card["training"]), "weights": True}
            for name, card in there
            if name != family["agent"]
        ]
    return [*entries, *_with_physics(entries), *_policies()]


def kept_families() -> list[dict[str, Any]]:
    """Families and presets of this project; see ``agents.shipping.families``."""
    return json.loads((Path(__file__).parent / "families.json").read_text(encoding="utf-8"))


def _families() -> list[dict[str, Any]]:
    """Families and presets from the file, or counted anew if an extension has added a family."""
    kept = kept_families()
    registry = sys.modules.get(_REGISTRY)
    if registry is None or set(registry.AGENTS) <= {entry["agent"] for entry in kept}:
        return kept
    # Imported here: this loads PyTorch and all systems.
    from agents.shipping.families import families

    return families()


def _with_physics(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Kinematic systems that can run with the tracker behind them."""
    tracker = resolve(ESTIMATE_TRACKER)
    behind = _parameters(SHIPPED / ESTIMATE_TRACKER)
    return [
        {
            **entry,
            "agent": with_physics([entry["agent"]])[0],
            "title": f"{entry['title']}, followed by the tracker's torques",
            "parameters": entry["parameters"] + behind,
            "licence": strictest([entry["licence"], licence_of(tracker.training)]),
            "weights": True,
        }
        for entry in entries
        if entry["weights"] or entry["agent"] in UNTRAINED
    ]


def _policies() -> list[dict[str, Any]]:
    entries = []
    for name in shipped_policies():
        card = resolve(SHIPPED / name).card
        follows_reference = "privileged" in card["network"]["actor_blocks"]
        entries.append(
            {
                "agent": name,
                "preset": card["training"].get("preset", "-"),
                "title": "torque policy that follows a full-body reference, not devices"
                if follows_reference
                else "torque policy",
                "sensors": ["reference" if follows_reference else card["needs"]["sensors"]],
                "parameters": _parameters(SHIPPED / name),
                "licence": licence_of(card["training"]),
                "weights": True,
            }
        )
    return entries


def _parameters(folder: Path) -> int:
    """Trained numbers of a policy, from the shapes in the first bytes of its weights."""
    with (folder / "policy.safetensors").open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        tensors = json.loads(file.read(length))
    return sum(
        math.prod(tensor["shape"])
        for name, tensor in tensors.items()
        if name != "__metadata__" and not name.endswith(_STATISTICS)
    )


def list_agents(args: AgentsArgs) -> None:
    """Print the catalogue as a table or as JSON."""
    entries = catalogue()
    if args.json:
        print(json.dumps(entries, indent=1))
        return
    rows = [("agent", "preset", "size", "weights", "licence of the weights", "sensors", "what")]
    for entry in entries:
        weights = "shipped" if entry["weights"] else "not trained"
        if not entry["parameters"]:
            weights = "needs none"
        sensors, size = ", ".join(entry["sensors"]), f"{entry['parameters'] / 1e6:.2f} M"
        words = (entry["agent"], entry["preset"], size, weights, entry["licence"], sensors)
        rows.append((*words, entry["title"]))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
        print("  ".join(cells).rstrip())
    print("sensors: H headset, 2C two controllers, IMU inertial sensor, 6T six trackers;")
    print("reference: the full-body motion. To watch one: questsim demo --agent NAME")
