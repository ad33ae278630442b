import gzip
import hashlib
import threading
import zipfile
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from mocap_files import BANDAI_ROOT, BANDAI_ZIP, SMPL_JOINTS, standing, write_bvh

from questsim.errors import InputError
from questsim.motion import datasets
from questsim.motion.datasets import DATASETS, Dataset, fetch, is_fetched, manifest, split_names

ROOT = "tiny-0123/dataset/Tiny-2/"


@pytest.fixture
def tiny(tmp_path, monkeypatch) -> Iterator[dict[str, bytes]]:
    """A dataset of three clips, whose archive is ``tmp_path / "tiny.zip"``."""
    monkeypatch.setenv("QUESTSIM_CACHE", str(tmp_path / "cache"))
    data = tmp_path / "data"
    data.mkdir()
    monkeypatch.setattr(datasets, "DATA", data)
    url = "http://127.0.0.1:9/nothing.zip"
    tiny = Dataset("tiny", "Tiny-2", url, "Tiny-2", "CC0-1.0", "nobody")
    monkeypatch.setitem(DATASETS, "tiny", tiny)
    clips = {}
    for kind in ("walk", "run", "wave"):
        path = write_bvh(tmp_path / "a.bvh", SMPL_JOINTS, standing(4 + len(kind), 0.95))
        clips[f"dataset-2_{kind}_normal_001.bvh"] = path.read_bytes()
        path.unlink()
    lines = [f"{hashlib.sha256(c).hexdigest()}  {name}\n" for name, c in clips.items()]
    with gzip.open(data / "tiny.sha256.gz", "wt") as file:
        file.writelines(lines)
    (data / "tiny-test.txt").write_text("dataset-2_run_normal_001\n")
    manifest.cache_clear()
    archive(tmp_path / "tiny.zip", clips)
    yield clips
    manifest.cache_clear()


def archive(path: Path, clips: dict[str, bytes], root: str = ROOT + "data/") -> Path:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(ROOT.replace("-2", "-1") + "data/dataset-2_walk_normal_001.bvh", "another")
        file.writestr(ROOT + "LICENSE", "CC0")
        file.writestr(ROOT + "data/../../../../escaped.bvh", "evil")
        for name, content in clips.items():
            file.writestr(root + name, content)
    return path


def test_every_clip_is_unpacked_verified_and_credited(tiny, tmp_path, capsys):
    folder = fetch("tiny", str(tmp_path / "tiny.zip"))
    assert {p.name: p.read_bytes() for p in folder.glob("*.bvh")} == tiny
    assert (folder / "LICENSE").read_text() == "CC0"
    assert not list(tmp_path.rglob("escaped.bvh"))
    out = capsys.readouterr().out
    assert "CC0-1.0" in out and "nobody" in out and "3 clips verified" in out
    assert is_fetched("tiny")


def test_clips_already_unpacked_are_kept_and_only_the_others_are_unpacked(tiny, tmp_path, capsys):
    names = sorted(tiny)
    part = archive(tmp_path / "part.zip", {name: tiny[name] for name in names[:2]})
    with pytest.raises(InputError, match=f"1 of 3 clips are missing, e.g. {names[2]}"):
        fetch("tiny", str(part))
    assert not is_fetched("tiny")
    folder = datasets.dataset_folder("tiny")
    times = {name: (folder / name).stat().st_mtime_ns for name in names[:2]}
    rest = archive(tmp_path / "rest.zip", {names[2]: tiny[names[2]]})
    fetch("tiny", str(rest))
    assert "2 were there already" in capsys.readouterr().out
    assert times == {name: (folder / name).stat().st_mtime_ns for name in names[:2]}
    fetch("tiny", str(tmp_path / "not needed.zip"))
    assert "3 were there already" in capsys.readouterr().out


def test_a_clip_that_was_damaged_on_disk_is_unpacked_again(tiny, tmp_path):
    folder = fetch("tiny", str(tmp_path / "tiny.zip"))
    name = min(tiny)
    (folder / name).write_bytes(b"damaged")
    fetch("tiny", str(tmp_path / "tiny.zip"))
    assert (folder / name).read_bytes() == tiny[name]


def test_a_clip_that_differs_from_the_manifest_is_refused(tiny, tmp_path):
    name = min(tiny)
    wrong = archive(tmp_path / "wrong.zip", tiny | {name: tiny[name] + b" "})
    with pytest.raises(InputError, match=f"1 of 3 clips differ from the manifest, e.g. {name}"):
        fetch("tiny", str(wrong))
    assert not (datasets.dataset_folder("tiny") / name).exists()
    assert not is_fetched("tiny")


def test_clips_inside_data_zip_are_found(tiny, tmp_path):
    inner = archive(tmp_path / "data.zip", tiny, root="data/")
    outer = tmp_path / "outer.zip"
    with zipfile.ZipFile(outer, "w") as file:
        file.write(inner, ROOT + "data.zip")
    assert len(list(fetch("tiny", str(outer)).glob("*.bvh"))) == 3


@pytest.fixture
def server(tmp_path):
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    handler.log_message = lambda *args: None  # type: ignore[attr-defined]
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


def test_a_mirror_url_is_downloaded_and_the_archive_removed_afterwards(tiny, tmp_path, server):
    fetch("tiny", f"{server}/tiny.zip")
    assert is_fetched("tiny")
    assert list((tmp_path / "cache" / "downloads").iterdir()) == []
    with pytest.raises(InputError, match="no dataset 'none'"):
        fetch("none")


def test_a_download_that_fails_or_is_no_archive_says_so(tiny, tmp_path, server):
    with pytest.raises(InputError, match=r"download failed .*404"):
        fetch("tiny", f"{server}/none.zip")
    with pytest.raises(InputError, match="download failed"):
        fetch("tiny")  # its public address is closed
    (tmp_path / "page.zip").write_text("<html>sorry</html>")
    with pytest.raises(InputError, match="is damaged or not a zip archive"):
        fetch("tiny", f"{server}/page.zip")
    assert list((tmp_path / "cache" / "downloads").iterdir()) == []
    with pytest.raises(InputError, match="no such mirror file"):
        fetch("tiny", str(tmp_path / "none.zip"))
    assert not datasets.dataset_folder("tiny").exists()


def test_the_shipped_manifest_and_splits_are_those_of_the_dataset():
    assert len(manifest("bandai-namco-2")) == 2902
    train, test = (split_names("bandai-namco-2", split) for split in ("train", "test"))
    assert (len(train), len(test)) == (2608, 294)
    assert not set(train) & set(test)
    assert sorted(train + test) == split_names("bandai-namco-2", None)
    with pytest.raises(InputError, match="no split 'valid'"):
        split_names("bandai-namco-2", "valid")


def test_the_mirror_matches_the_shipped_manifest():
    if not BANDAI_ZIP.is_file():
        pytest.skip(f"{BANDAI_ZIP} is not here")
    known = manifest("bandai-namco-2")
    with zipfile.ZipFile(BANDAI_ZIP) as mirror:
        for name in sorted(known)[::100]:
            content = mirror.read(f"{BANDAI_ROOT}data/{name}")
            assert hashlib.sha256(content).hexdigest() == known[name]
