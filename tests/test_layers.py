"""Each package imports only those below it, and no module imports itself by way of others."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("questsim", "envs", "agents")
FORBIDDEN = {
    "questsim": {"envs", "agents", "benchmarks", "train", "evaluate"},
    "envs": {"agents", "benchmarks", "train", "evaluate"},
    "agents": {"benchmarks", "train", "evaluate"},
}
ALLOWED = {ROOT / "questsim" / "cli.py"}
ORDER = (
    "precision", "overrides", "licence", "run_folder", "hub", "resolve",
    "agent", "policy", "loading",
    "evaluation", "training", "sweep", "kinematic", "comparison", "shipping", "live",
    "follower", "headset", "commands",
)  # fmt: skip
"""Folders and modules of ``agents``: each imports only those before it."""


def imports(source: str, types: bool = False) -> set[str]:
    """What a module imports anywhere, also in functions and by importlib and a literal name.

    What only a type checker imports counts with ``types``. ``from x import y`` counts as both
    ``x`` and ``x.y``, which may be a module.
    """
    found, waiting = set(), [ast.parse(source)]
    while waiting:
        node = waiting.pop()
        checked = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if isinstance(node, ast.If) and checked and not types:
            waiting += node.orelse
            continue
        waiting += list(ast.iter_child_nodes(node))
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module)
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
        elif (
            isinstance(node, ast.Call)
            and getattr(node.func, "attr", getattr(node.func, "id", ""))
            in ("import_module", "__import__")
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            found.add(str(node.args[0].value))
    return found


def imported_packages(source: str) -> set[str]:
    return {name.partition(".")[0] for name in imports(source)}


@cache
def graph(types: bool = False) -> dict[str, set[str]]:
    """Which module of the project imports which; with ``types`` also for a type checker alone."""
    paths = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            paths[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    # A package is what its __init__ imports; ``from package import module`` is of the module.
    found = {}
    for name, path in paths.items():
        known = {other for other in imports(path.read_text(), types) if other in paths} - {name}
        outer = {other.rpartition(".")[0] for other in known}
        found[name] = {
            other for other in known if other not in outer or paths[other].name != "__init__.py"
        }
    return found


def circle(edges: dict[str, set[str]]) -> list[str] | None:
    """Modules of which each imports the next, and the last the first; None without any."""
    done: set[str] = set()

    def walk(name: str, path: list[str]) -> Iterator[list[str]]:
        if name in path:
            yield [*path[path.index(name) :], name]
        elif name not in done:
            for other in sorted(edges.get(name, ())):
                yield from walk(other, [*path, name])
            done.add(name)

    return next((found for name in sorted(edges) for found in walk(name, [])), None)


def part_of(module: str) -> str:
    """The folder or module of ``agents`` that a module is in."""
    return module.split(".")[1] if "." in module else ""


@pytest.mark.parametrize("package", FORBIDDEN)
def test_package_imports_only_packages_below_it(package):
    files = [path for path in (ROOT / package).rglob("*.py") if path not in ALLOWED]
    assert files
    offenders = {
        str(path.relative_to(ROOT)): sorted(bad)
        for path in files
        if (bad := imported_packages(path.read_text()) & FORBIDDEN[package])
    }
    assert not offenders


def test_no_module_imports_itself_by_way_of_others():
    edges = graph()
    assert len(edges) > 100
    assert circle(edges) is None


def test_no_module_imports_itself_for_a_type_checker_either():
    assert graph(types=True) != graph()
    assert circle(graph(types=True)) is None


def test_folders_of_agents_import_only_those_before_them():
    backward = []
    for module, imported in graph().items():
        for other in imported:
            if not module.startswith("agents.") or not other.startswith("agents."):
                continue
            if ORDER.index(part_of(other)) > ORDER.index(part_of(module)):
                backward.append(f"{module} imports {other}")
    assert not backward


def test_the_check_sees_every_way_to_import():
    source = """
from typing import TYPE_CHECKING
import agents.training.ppo
if TYPE_CHECKING:
    import docs.only_types
def f():
    from envs.core import BatchSim
    import importlib
    importlib.import_module("benchmarks.x")
"""
    assert imported_packages(source) == {"agents", "envs", "benchmarks", "importlib", "typing"}
    assert "docs.only_types" in imports(source, types=True)


def test_the_check_sees_a_circle_of_three():
    found = circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})
    assert found == ["a", "b", "c", "a"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) is None
