"""The tables of ablations in the pages (docs/figures/ablation_tables.py)."""

import json

import pytest

from docs.figures import ablation_tables
from docs.figures.ablation_tables import KEPT, PAGE, described, table_of, unseen, written
from questsim.errors import InputError


def report() -> dict:
    scenarios = ("6", "6; old")
    values = {"full": (1.0, 2.0), "held-out": (1.5, 5.0)}
    training = {"generator": {"steps": 1000, "minutes": 3.0}, "ik": {"steps": 20, "minutes": 1.0}}
    return {
        "agent": "sparseposer", "preset": "cpu", "stage": "all", "teacher": None,
        "motions": "a", "minutes": None, "steps": 1000, "seed": 0,
        "seeds": 1, "hold_out": "old", "set": [], "test": "b", "clips": 7,
        "variants": [{"name": n, "what": "", "training": training} for n in values],
        "rows": [
            {"variant": n, "scenario": s, "clips": 7, "pos_cm": v}
            for n, row in values.items() for s, v in zip(scenarios, row, strict=True)
        ],
    }  # fmt: skip


def page_with(place, kept, rows, tmp_path, monkeypatch) -> str:
    """The page in which ``--write`` fills a place from a report with these rows."""
    context = {k: kept[k] for k in ("agent", *ablation_tables.CONTEXT)}
    context["data"] = {"motions": kept["test"], "clips": kept["clips"]}
    whole = {"schema": "questsim-ablations", "version": 1, "context": context,
             "variants": kept["variants"], "rows": rows}  # fmt: skip
    (tmp_path / "ablations.json").write_text(json.dumps(whole))
    (tmp_path / "page.md").write_text(f"a\n<!-- ablations: {place} -->\nold\n<!-- end -->\nb\n")
    for name, file in (("KEPT", "kept.json"), ("PAGE", "page.md"), ("PICTURE", "picture.png")):
        monkeypatch.setattr(ablation_tables, name, tmp_path / file)
    monkeypatch.setattr("sys.argv", ["", "--write", str(tmp_path / "ablations.json")])
    ablation_tables.main()
    return (tmp_path / "page.md").read_text()


def test_the_page_has_the_kept_tables() -> None:
    text = PAGE.read_text("utf-8")
    assert written(text, json.loads(KEPT.read_text("utf-8"))) == text
    assert text.count("<!-- ablations: ") == len(json.loads(KEPT.read_text("utf-8")))


def test_differences_are_from_the_whole_system_and_unseen_clips_have_a_column() -> None:
    lines = table_of(report()).splitlines()
    assert lines[0] == "| variant | pos (cm), 6 | pos (cm), 6 *unseen* | steps |"
    assert lines[2] == "| `full` | 1.00 | 2.00 | 1,000 + 20 |"
    assert lines[3] == "| `held-out` | 1.50 (+0.50) | 5.00 (+3.00) | 1,000 + 20 |"
    assert "styles old." in described(report()) and "1,000 steps a stage" in described(report())
    assert unseen({"sparseposer": report()}) == [("sparseposer", "6", "pos_cm", 2.0, 5.0)]


def test_one_stage_of_questsim_has_a_place_of_its_own_and_few_figures_of_unseen_clips(
    tmp_path, monkeypatch
) -> None:
    own = report()
    figures = {"success_percent": 90.0, "mpjpe_cm": 3.0, "jitter_100_m_s3": 1.0,
               "foot_skate_cm_s": 2.0}  # fmt: skip
    rows = [
        {"variant": name, "scenario": where, "clips": 7, "pooled": figures}
        for name in ("full", "held-out")
        for where in ("from the user's state", "from the user's state; old")
    ]
    more = {"agent": "questsim", "stage": "student", "teacher": "tracker"}
    page = page_with("questsim-student", own | more, rows, tmp_path, monkeypatch).splitlines()
    assert page[3].startswith("Stage `student` alone, taught by `tracker`. Each trained on")
    assert page[5] == (
        "| variant | success (%) | MPJPE (cm) | jitter (100 m/s³) | skate (cm/s) | "
        "success (%) *unseen* | MPJPE (cm) *unseen* | steps |"
    )
    assert page[8].startswith("| `held-out` | 90.00 (+0.00) | 3.00 (+0.00) |")


def test_a_named_report_replaces_the_kept_one_of_its_agent(tmp_path, monkeypatch, capsys) -> None:
    own = report()
    rows = [
        {**{k: v for k, v in row.items() if k != "pos_cm"}, "pooled": {"pos_cm": row["pos_cm"]}}
        for row in own["rows"]
    ]
    page = page_with("sparseposer", own, rows, tmp_path, monkeypatch)
    assert json.loads((tmp_path / "kept.json").read_text()) == {"sparseposer": own}
    assert table_of(own) in page and "old\n<!--" not in page and page.startswith("a\n")
    assert (tmp_path / "picture.png").stat().st_size > 1000
    (tmp_path / "kept.json").write_text("{}")
    monkeypatch.setattr("sys.argv", ["", str(tmp_path / "gone.json")])
    with pytest.raises(InputError, match=r"gone\.json"):
        ablation_tables.main()
