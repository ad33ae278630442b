"""The cards of the shipped kinematic systems, and the tables that their figures come from."""

import json
import shutil

import pytest

from agents.comparison.report import LABELS, SCHEMA, SCHEMA_VERSION
from agents.kinematic.store import read_system_card
from agents.resolve import SHIPPED, shipped_systems
from agents.shipping.cards import SOURCE, figures_text, rewrite_cards
from agents.shipping.system_card import SHOWN
from docs.figures.comparison_table import PAGES, rows_of, written


def report_of(names, folder, value=1.234):
    trained = {name: read_system_card(SHIPPED / name)["training"] for name in names}
    rows = [
        {"agent": name, "scenario": "6", "clips": 4, "pooled": dict.fromkeys(SHOWN, value)}
        for name in names
    ]
    data = {"motions": "some:test", "clips": 4}
    path = folder / "comparison.json"
    context = {"agents": trained, "data": data}
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
