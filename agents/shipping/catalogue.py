"""``questsim agents``: list every agent and preset with sensors, size and shipped weights."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from agents.kinematic.ik import DEVICES as IK_DEVICES
from agents.kinematic.registry import AGENTS
from agents.kinematic.store import CARD_FILE, read_system_card
from agents.licence import OURS, licence_of, strictest
from agents.policy.checkpoint import load_policy, read_card
from agents.resolve import ESTIMATE_TRACKER, IK, SHIPPED, shipped_policies, with_physics

KEYS = ("agent", "preset", "title", "sensors", "parameters", "licence", "weights")


@dataclass(frozen=True)
class AgentsArgs:
    """List every agent and preset."""

    json: bool = False
    """Print JSON, for programs."""


def catalogue() -> list[dict[str, Any]]:
    """One entry per agent and preset, with ``KEYS``.

    ``sensors`` are the sets of devices that it can use, or ``reference`` if it observes the whole
    body of a reference motion instead. ``parameters`` counts trainable parameters. ``licence`` is
    that of the weights, or of the code if there are no weights. ``weights`` says whether weights
    are shipped.
    """
    shipped = [
        (folder.parent, read_system_card(folder.parent))
        for folder in sorted(SHIPPED.glob(f"*/{CARD_FILE}"))
    ]
    entries = []
    for name, agent in AGENTS.items():
        for preset, config in agent.presets.items():
            there = [
                (folder.name, card)
                for folder, card in shipped
                if card["agent"] == name and card["training"].get("preset") == preset
            ]
            module = agent.build(config.spec)
            own = [card for folder, card in there if folder == name]
            entry = {
                "agent": name,
                "preset": preset,
                "title": agent.title,
                "sensors": list(agent.sensors),
                "parameters": sum(p.numel() for p in module.parameters()),
                "licence": licence_of(own[0]["training"]) if own else OURS,
                "weights": bool(own),
            }
            entries.append(entry)
            # Weights of the same system under another name, e.g. trained with another loss.
            entries += [
                {
                    **entry,
                    "agent": folder,
                    "licence": licence_of(card["training"]),
                    "weights": True,
                }
                for folder, card in there
                if folder != name
            ]
    entries.append(
        {
            "agent": IK,
            "preset": "-",
            "title": f"inverse kinematics (mink) of {len(IK_DEVICES)} trackers",
            "sensors": ["6T"],
            "parameters": 0,
            "licence": OURS,
            "weights": False,
        }
    )
    return [*entries, *_with_physics(entries), *_policies()]


def _with_physics(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Kinematic systems that can run with the tracker behind them."""
    tracker = load_policy(SHIPPED / ESTIMATE_TRACKER)
    behind = sum(p.numel() for p in tracker.policy.parameters())
    licence = licence_of(tracker.card["training"])
    return [
        {
            **entry,
            "agent": with_physics([entry["agent"]])[0],
            "title": f"{entry['title']}, followed by the tracker's torques",
            "parameters": entry["parameters"] + behind,
            "licence": strictest([entry["licence"], licence]),
            "weights": True,
        }
        for entry in entries
        if entry["weights"] or not entry["parameters"]
    ]


def _policies() -> list[dict[str, Any]]:
    entries = []
    for name in shipped_policies():
        card, policy = read_card(SHIPPED / name), load_policy(SHIPPED / name).policy
        follows_reference = "privileged" in policy.spec.actor_blocks
        entries.append(
            {
                "agent": name,
                "preset": card["training"].get("preset", "-"),
                "title": "torque policy that follows a full-body reference, not devices"
                if follows_reference
                else "torque policy",
                "sensors": ["reference" if follows_reference else card["needs"]["sensors"]],
                "parameters": sum(p.numel() for p in policy.parameters()),
                "licence": licence_of(card["training"]),
                "weights": True,
            }
        )
    return entries


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
