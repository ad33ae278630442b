"""The cards of the shipped kinematic systems, and the tables that their figures come from."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from agents.comparison.report import LABELS, SCHEMA, SCHEMA_VERSION, Row
from agents.kinematic.store import read_system_card
from agents.resolve import SHIPPED, shipped_systems
from agents.shipping.cards import SOURCE, figures_text, rewrite_cards
from agents.shipping.system_card import SHOWN, _signals
from docs.figures.comparison_table import (
    PAGES,
    course,
    full,
    gains,
    noise,
    rows_of,
    short,
    starts,
    written,
)
from questsim.errors import InputError


def report_of(names, folder, value=1.234, ms=None):
    trained = {name: read_system_card(SHIPPED / name)["training"] for name in names}
    rows = [
        {
            "agent": name,
            "scenario": "6",
            "clips": 4,
            "parameters": 10,
            "ms": ms,
            "pooled": dict.fromkeys(SHOWN, value),
        }
        for name in names
    ]
    data = {"motions": "some:test", "clips": 4}
    path = folder / "report.json"
    context = {"agents": trained, "data": data, "versions": {}}
    path.write_text(
        json.dumps({"schema": SCHEMA, "version": SCHEMA_VERSION, "context": context, "rows": rows})
    )
    return path


@pytest.mark.skipif(not SOURCE.exists(), reason="no table has been kept with the weights yet")
@pytest.mark.parametrize("name", [n for n in shipped_systems() if (SHIPPED / n).exists()])
def test_every_cards_figures_are_those_of_the_kept_table(name):
    compared = json.loads(SOURCE.read_text(encoding="utf-8"))["context"]["agents"]
    if name not in compared:
        pytest.skip(f"{name} is not in the table")
    card = (SHIPPED / name / "README.md").read_text(encoding="utf-8")
    assert figures_text(SOURCE, SHIPPED / name) in card


@pytest.mark.skipif(not SOURCE.exists(), reason="no table has been kept with the weights yet")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_tables_in_the_pages_are_those_of_the_kept_table(page):
    text = page.read_text(encoding="utf-8")
    assert "<!-- comparison: " in text and written(page, rows_of(SOURCE)) == text


def test_cards_get_new_figures_and_keep_the_rest(tmp_path):
    for name in ("lgsik", "dragposer"):
        shutil.copytree(SHIPPED / name, tmp_path / name)
    report = report_of(["lgsik"], tmp_path)
    before = (tmp_path / "lgsik" / "README.md").read_text(encoding="utf-8")
    other = (tmp_path / "dragposer" / "README.md").read_bytes()
    written = rewrite_cards(report, tmp_path)
    card = (tmp_path / "lgsik" / "README.md").read_text(encoding="utf-8")
    assert written == [tmp_path / "lgsik" / "README.md", tmp_path / SOURCE.name]
    assert "| 6 | 4 | 1.23 |" in card and LABELS["root_cm"] in card and "some:test, 4 clips" in card
    for heading in ("## Intended use", "## Limits", "## Licence"):
        assert card.count(heading) == before.count(heading) == 1
    assert card.split("## Figures")[0] == before.split("## Figures")[0]
    assert (tmp_path / "dragposer" / "README.md").read_bytes() == other
    assert figures_text(tmp_path / SOURCE.name, tmp_path / "lgsik") in card


def test_a_comparison_of_one_agent_replaces_its_rows_alone(tmp_path):
    for name in ("lgsik", "dragposer"):
        shutil.copytree(SHIPPED / name, tmp_path / name)
    rewrite_cards(report_of(["lgsik", "dragposer"], tmp_path, ms=2.5), tmp_path)
    (tmp_path / "one").mkdir()
    rewrite_cards(report_of(["lgsik"], tmp_path / "one", value=9.0), tmp_path)
    kept = json.loads((tmp_path / SOURCE.name).read_text(encoding="utf-8"))
    # The new row was not timed and has a network of the same size: the time stays.
    assert [(row["agent"], row["pooled"]["root_cm"], row["ms"]) for row in kept["rows"]] == [
        ("lgsik", 9.0, 2.5),
        ("dragposer", 1.234, 2.5),
    ]
    other = report_of(["lgsik"], tmp_path / "one")
    content = json.loads(other.read_text())
    content["context"]["data"]["clips"] = 5
    other.write_text(json.dumps(content))
    with pytest.raises(InputError, match="differs from the kept report in data, and lacks drag"):
        rewrite_cards(other, tmp_path)
    assert kept == json.loads((tmp_path / SOURCE.name).read_text(encoding="utf-8"))


def test_each_condition_has_its_column_and_the_usual_tables_have_none_of_them():
    def row(scenario, error, course=(), **more):
        return Row("a", scenario, 0, {}, {"mpjpe_cm": error, **more}, None, course_cm=list(course))

    exact, white = row("6", 1.0, np.arange(50.0)), row("6, noise: white", 2.0)
    assert "| a | 6 | 1.00 | 2.00 | - | - | - | - |" in noise([exact, white]).splitlines()
    assert course([exact, white]).splitlines()[2:] == [
        "| a | 6 | 0.00 | 1.00 | 2.00 | 3.00 | 5.00 | 6.00 | 10.00 | 20.00 | 40.00 |"
    ]
    # Exact signals on more clips: those of the same clips are compared.
    more = replace(exact, clips=2, fewer={"mpjpe_cm": 1.5})
    assert "| a | 6 | 1.50 | 2.00 | - | - | - | - |" in noise([more, white]).splitlines()
    own = row("HMD", 3.0, success_percent=90.0)
    standing = row("HMD, from standing", 4.0, success_percent=80.0)
    line = "| a | HMD | 0 | 90.00 | - | - | 80.00 | 3.00 | - | - | 4.00 |"
    assert starts([own, standing]).splitlines()[2:] == [line]
    of_all = row("HMD", 9.0, success_percent=50.0)
    of_all = replace(of_all, clips=2, fewer={"mpjpe_cm": 3.0, "success_percent": 90.0})
    assert starts([of_all, standing]).splitlines()[2:] == [line]
    for text in (full([exact, white, own, standing]), short([exact, white, own, standing])):
        assert "noise" not in text and "standing" not in text and "| a | 6 | " in text


def test_gains_are_the_change_from_headset_and_controllers_without_physics():
    def row(agent, scenario, error, **more):
        return Row(agent, scenario, 0, {}, {"mpjpe_cm": error, **more}, None)

    rows = [row("a", "HMD", 2.0), row("a", "HMD+3IMU", 1.5), row("b", "HMD", 1.0)]
    behind = [
        row("a+physics", "HMD", 2.0, success_percent=90.0),
        row("a+physics", "HMD+3IMU", 1.0, success_percent=90.0),
    ]
    assert gains([*rows, *behind]).splitlines()[2:] == [
        "| a | HMD | - | 2.00 | - | - | - | - | - |",
        "| a | HMD+3IMU | - | 1.50 (-25 %) | - | - | - | - | - |",
    ]


def test_what_is_no_report_of_a_comparison_is_refused_in_one_line(tmp_path):
    path = tmp_path / "metrics.json"
    with pytest.raises(InputError, match="cannot be read"):
        rows_of(path)
    path.write_text('{"schema": "questsim-metrics", "version": 1}')
    with pytest.raises(InputError, match="is not a report of a comparison"):
        rows_of(path)


def test_a_card_names_the_errors_of_the_devices_in_training():
    assert _signals(None) == "without noise, latency or loss of tracking"
    assert _signals({"position_m": 0.005, "mount_rad": 0.17}) == (
        "with white noise (5 mm, 0 rad) and devices worn up to 0 cm and 0.17 rad off, "
        "without latency or loss of tracking"
    )
