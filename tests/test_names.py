"""Names of agents and ``+physics`` are spelt out in two modules and nowhere else."""

import ast
import re
from pathlib import Path

import pytest

from agents.kinematic.registry import AGENTS
from agents.resolve import BASELINES, PHYSICS, shipped_policies, shipped_systems

ROOT = Path(__file__).parents[1]
NAMED_IN = {"agents/resolve.py", "agents/kinematic/registry.py"}
LOSSES = {f"agents/kinematic/recurrent/{name}.py" for name in ("lgsik", "training", "entry")}
"""LGSIK-Poser's losses bear the names of the systems that they are from."""
NAMES = {*shipped_policies(), *shipped_systems(), *BASELINES, *AGENTS}
WORDS = {"questsim", "demo", "tracker", "random", "zero", "ik"}
"""Names that are common words, too: searched only where an agent is meant."""
MEANT = re.compile(
    rf'(?:agent|policy|system)\w*(?:: [^=\n]+)? ?(?:==?|\()\s*"({"|".join(WORDS)})"', re.IGNORECASE
)


def spelt_out(source: str) -> set[str]:
    """Names of agents in the strings of a module, docstrings included."""
    found = set(MEANT.findall(source))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= set(re.findall(r"[\w-]+", node.value)) & (NAMES - WORDS)
            found |= {PHYSICS} if PHYSICS in node.value else set()
    return found


def test_no_other_module_spells_out_the_name_of_an_agent():
    files = [p for folder in ("agents", "envs", "questsim") for p in (ROOT / folder).rglob("*.py")]
    assert len(files) > 100
    found = {str(path.relative_to(ROOT)): spelt_out(path.read_text()) for path in files}
    assert {name for name, spelt in found.items() if spelt} - NAMED_IN - LOSSES == set()
    for name in LOSSES:
        assert found[name] <= {"lgsik", "lgsik-lengths", "hmdposer"}


@pytest.mark.parametrize(
    ("source", "name"),
    [
        ('agent: str = "questsim"', "questsim"),
        ('run(policy="zero")', "zero"),
        ('load_agent("demo")', "demo"),
        ('"""Such as ``hmdposer+physics``."""', "hmdposer"),
        ('if found == "questsim-now": pass', "questsim-now"),
        ('suffix = "+physics"', PHYSICS),
    ],
)
def test_the_check_sees_a_name(source, name):
    assert name in spelt_out(source)
    assert not spelt_out('tracker = SENSORS["tracker"]; import_module("questsim")')
