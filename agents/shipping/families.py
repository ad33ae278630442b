"""The families of kinematic systems as ``questsim agents`` lists them, kept in ``families.json``.

Counting the parameters of a network means building it, which takes seconds. After a change of a
family or a preset run ``python -m agents.shipping.families``; a test compares the file with it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from agents.kinematic.ik import DEVICES as IK_DEVICES
from agents.kinematic.registry import AGENTS
from agents.resolve import IK

FILE = Path(__file__).parent / "families.json"


def families() -> list[dict[str, Any]]:
    """One entry per family and preset: agent, preset, title, sensors, trainable parameters."""
    entries = [
        {
            "agent": name,
            "preset": preset,
            "title": agent.title,
            "sensors": list(agent.sensors),
            "parameters": sum(p.numel() for p in agent.build(config.spec).parameters()),
        }
        for name, agent in AGENTS.items()
        for preset, config in agent.presets.items()
    ]
    title = f"inverse kinematics (mink) of {len(IK_DEVICES)} trackers"
    return [
        *entries,
        {"agent": IK, "preset": "-", "title": title, "sensors": ["6T"], "parameters": 0},
    ]


if __name__ == "__main__":
    FILE.write_text(json.dumps(families(), indent=1) + "\n", encoding="utf-8")
