"""Each package imports only those below it: questsim, then envs, then agents."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "questsim": {"envs", "agents", "benchmarks", "train", "evaluate"},
    "envs": {"agents", "benchmarks", "train", "evaluate"},
    "agents": {"benchmarks", "train", "evaluate"},
}
ALLOWED = {ROOT / "questsim" / "cli.py"}


def imported_packages(source: str) -> set[str]:
    """Top-level packages that a module imports anywhere, also by importlib and a literal name."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module)
        elif (
            isinstance(node, ast.Call)
            and ast.unparse(node.func).endswith(("import_module", "__import__"))
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            found.add(str(node.args[0].value))
    return {name.partition(".")[0] for name in found}


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


def test_the_check_sees_every_way_to_import():
    source = """
import agents.training.ppo
def f():
    from envs.core import BatchSim
    import importlib
    importlib.import_module("benchmarks.x")
"""
    assert imported_packages(source) == {"agents", "envs", "benchmarks", "importlib"}
