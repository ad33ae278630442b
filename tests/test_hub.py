"""Publishing to the Hugging Face Hub and using agents from it: the real client, a local server."""

from __future__ import annotations

import sys

import pytest
import yaml
from hub_server import TOKEN, Repository, hub_server

from agents import hub
from agents.policy.checkpoint import save_policy
from agents.resolve import SHIPPED, resolve
from questsim.cli import main
from questsim.errors import InputError


@pytest.fixture
def server(tmp_path, monkeypatch):
    pytest.importorskip("huggingface_hub", reason="huggingface-hub is not installed")
    with hub_server() as (address, repositories):
        monkeypatch.setenv("HF_ENDPOINT", address)
        monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
        monkeypatch.setenv("HF_TOKEN", TOKEN)
        for module in [name for name in sys.modules if name.split(".")[0] == "huggingface_hub"]:
            monkeypatch.delitem(sys.modules, module)  # it reads HF_ENDPOINT when it is imported
        hub.downloaded.cache_clear()
        yield repositories
        hub.downloaded.cache_clear()


@pytest.mark.parametrize(
    ("name", "card", "licence"),
    [("demo", "policy.yaml", "mit"), ("lgsik", "system.yaml", "cc-by-nc-4.0")],
)
def test_a_published_agent_is_used_by_its_name(server, capsys, name, card, licence):
    assert main(["publish", name, f"hf:me/{name}"]) == 0
    assert "published hf:me/" in capsys.readouterr().out
    found = resolve(f"hf:me/{name}")
    assert found.kind == resolve(name).kind
    assert found.folder is not None
    for file in (SHIPPED / name).iterdir():
        if file.name != "README.md":
            assert (found.folder / file.name).read_bytes() == file.read_bytes()
    assert (found.folder / card).is_file()
    _, header, text = server[f"me/{name}"]["README.md"].decode().split("---\n", 2)
    assert yaml.safe_load(header)["license"] == licence
    assert text.strip() == (SHIPPED / name / "README.md").read_text().strip()
    if name == "demo":
        argv = f"evaluate --agent hf:me/{name} --motions synthetic:stand --max-clips 1 --threads 1"
        assert main(argv.split()) == 0


def test_names_that_cannot_be_used_are_refused(server):
    server["me/empty"] = Repository({"README.md": b"nothing here"})
    for name, message in (
        ("hf:me", "is not hf:USER/REPO"),
        ("hf:me/demo@", "has no revision"),
        ("hf:me/nothing", "there is no such repository on the Hub"),
        ("hf:me/empty@v2", "there is no such revision"),
        ("hf:me/empty", "holds no agent of questsim"),
    ):
        with pytest.raises(InputError, match=message):
            resolve(name)


def test_weights_without_a_licence_or_a_valid_token_are_not_published(
    server, tmp_path, monkeypatch, capsys
):
    assert main(["publish", "zero", "hf:me/zero"]) == 2
    assert "has no weights to publish" in capsys.readouterr().err
    from agents.loading import load_agent

    demo = load_agent("demo")
    training = {"licences": {"not stated": 1}, "motions": "own", "clips": 1}
    save_policy(tmp_path / "own", demo.policy, demo.needs, training)  # type: ignore[attr-defined]
    (tmp_path / "own" / "README.md").write_text("a card")
    assert main(["publish", str(tmp_path / "own"), "hf:me/own"]) == 2
    assert "have no stated licence" in capsys.readouterr().err
    monkeypatch.setenv("HF_TOKEN", "hf_wrong")
    assert main(["publish", "demo", "hf:me/demo"]) == 2
    assert "the Hub answered 401; run hf auth login" in capsys.readouterr().err
    assert not server


def test_without_a_network_the_cache_serves_and_other_names_are_refused(
    server, monkeypatch, capsys
):
    assert main(["publish", "demo", "hf:me/demo"]) == 0
    folder = resolve("hf:me/demo").folder
    hub.downloaded.cache_clear()
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "ENDPOINT", "http://127.0.0.1:1")
    assert resolve("hf:me/demo").folder == folder
    with pytest.raises(InputError, match="the Hub does not answer"):
        resolve("hf:me/other")
    capsys.readouterr()
    assert main(["publish", "demo", "hf:me/demo"]) == 2
    assert "the Hub does not answer" in capsys.readouterr().err


def test_without_the_client_a_name_of_the_hub_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    hub.downloaded.cache_clear()
    with pytest.raises(InputError, match=r"pip install 'questsim\[hub\]'"):
        resolve("hf:me/demo")
