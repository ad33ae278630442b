"""What the documentation points to is there."""

import os
import re
import subprocess
import sys
import tomllib
from dataclasses import fields, is_dataclass
from itertools import chain
from pathlib import Path
from typing import get_type_hints

import pytest
import yaml

from questsim.cli import COMMANDS
from questsim.lazy import imported
from questsim.modes import Modes
from questsim.viewing import gl

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_local_links_lead_somewhere(page):
    targets = re.findall(r"\]\((?!https?://)([^)#]+)", page.read_text())
    assert not [target for target in targets if not (page.parent / target).exists()]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_source_files_that_are_named_exist(page):
    text = page.read_text()
    if page.name == "CHANGELOG.md":  # a release keeps the names that it had
        text = text.partition("\n## [0.")[0]
    names = re.findall(r"`((?:questsim|envs|agents|tests|assets)/[\w./]*)`", text)
    assert not [name for name in names if not (ROOT / name).exists()]


def test_index_lists_every_page():
    listed = set(re.findall(r"\]\(([\w-]+\.md)\)", (ROOT / "docs" / "index.md").read_text()))
    assert {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"} == listed


def test_make_targets_that_are_named_exist():
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {
        word
        for page in PAGES
        for word in re.findall(r"(?:^|`)make ([\w-]+)", page.read_text(), re.MULTILINE)
    }
    assert "demo" in named
    assert named <= targets


def test_the_workflow_runs_what_ci_runs_on_every_python_of_the_package():
    job = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())["jobs"]["test"]
    ran = {line for step in job["steps"] for line in re.findall("make [^|]+", step.get("run", ""))}
    ours = {
        line.strip() for line in re.findall("^make [^|\n]+", (ROOT / ".ci/run").read_text(), re.M)
    }
    assert {line.replace("PYTHON=python", "").strip() for line in ran} == ours
    matrix = job["strategy"]["matrix"]
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "macos"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["requires-python"] == f">={matrix['python'][0]}"
    assert matrix["python"] == ["3.11", "3.12", "3.13"]


def test_every_dependency_is_pinned():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + [*chain(*project["optional-dependencies"].values())]
    pins = (ROOT / "constraints.txt").read_text().lower().replace("_", "-")
    names = {re.split(r"[<>=\[]", requirement)[0] for requirement in wanted} - {project["name"]}
    names -= {"trackio"}  # needs an older pillow than the pinned one, so it is installed without
    assert not [name for name in names if f"\n{name}==" not in pins]


# What the text around a page's code takes for granted.
GIVEN = {
    "metrics.md": "from rollouts import rollout, still_clip; rollouts = [rollout(still_clip(40))]",
    "export.md": """
from agents.policy.export import ExportArgs, export
from pathlib import Path
export(ExportArgs("demo", Path("questsim.onnx")))""",
}


@pytest.mark.parametrize(
    "page", [p for p in PAGES if "```python" in p.read_text()], ids=lambda page: page.name
)
def test_python_in_the_pages_runs(page, tmp_path, monkeypatch):
    code = "\n".join(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))
    if "SceneRenderer" in code and gl.find_gl() is None:
        pytest.skip(gl.missing_gl())
    monkeypatch.chdir(tmp_path)
    exec(GIVEN.get(page.name, "") + "\n" + code, {})


def test_the_site_has_every_page():
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    listed = re.findall(r"[\w/-]+\.md", str(nav))
    docs = ROOT / "docs"
    assert sorted(listed) == sorted(str(p.relative_to(docs)) for p in docs.rglob("*.md"))


def test_the_site_builds_without_a_warning(tmp_path):
    command = f"{sys.executable} -m mkdocs build --strict --quiet --site-dir {tmp_path}"
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command.split(), cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "BatchSim" in (tmp_path / "api" / "envs.html").read_text()


def commands() -> list[str]:
    """Every command in the pages' code blocks (without its comment) and tables."""
    found = []
    for page in PAGES:
        for line in re.findall(
            r"^(?:    )?((?:questsim|python) .+)$", page.read_text(), re.MULTILINE
        ):
            found.append(re.sub(r"\s+#.*", "", line).strip())
        for row in re.findall(r"^\|.*", page.read_text(), re.MULTILINE):
            found += re.findall(r"`((?:questsim|python) [^`]+)`", row)
    return sorted({line for line in found if not line.endswith("\\") and "|" not in line})


def test_commands_in_the_pages_have_the_options_that_are_given():
    lines = commands()
    assert len(lines) > 10
    wrong = []
    for line in lines:
        words = line.split()
        if words[:2] == ["python", "train.py"]:
            words = ["questsim", "train", *words[2:]]
        elif words[:2] == ["python", "evaluate.py"]:
            words = ["questsim", "evaluate", *words[2:]]
        names = [n for n in (" ".join(words[1:3]), words[1]) if n in COMMANDS]
        if words[0] != "questsim" or not names:
            continue
        command = COMMANDS[names[0]]
        args = imported(command.args)
        if isinstance(args, Modes):
            mode, words = args.chosen(words[2:])
            args = mode.args
        known = {f.name for f in fields(args)}
        groups = {name: kind for name, kind in get_type_hints(args).items() if is_dataclass(kind)}
        known |= {f"{name}.{f.name}" for name, kind in groups.items() for f in fields(kind)}
        given = {w[2:].split("=")[0].replace("-", "_") for w in words if w.startswith("--")}
        given = {g.removeprefix("no_") if g not in known else g for g in given}
        wrong += [f"{line}: {option}" for option in given - known - {"help", "set"}]
    assert not wrong
