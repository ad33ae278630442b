"""Public datasets: downloaded once; every clip is verified against a shipped manifest."""

from __future__ import annotations

import gzip
import hashlib
import io
import re
import zipfile
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from urllib.parse import urlparse
from urllib.request import url2pathname

from questsim.errors import InputError
from questsim.files import whole_file
from questsim.motion.cache import cache_dir

DATA = Path(__file__).parent / "data"
MAX_MEMBER_BYTES = 64 * 2**20
SPLITS = ("train", "test")
FORMATS = (".bvh", ".npz")
"""Endings of the motion files of a data set."""


@dataclass(frozen=True)
class Dataset:
    """A public dataset.

    Attributes:
        name: its name in motion arguments.
        title: its full name.
        url: the archive.
        folder: the folder inside the archive that holds it.
        licence: SPDX identifier.
        credit: the attribution and the source.
        data: the folder of ``NAME.sha256.gz`` (a line ``DIGEST  FILE`` for each clip) and
            ``NAME-test.txt`` (names of the test clips), see ``write_manifest``; None for the
            package's own.
    """

    name: str
    title: str
    url: str
    folder: str
    licence: str
    credit: str
    data: Path | None = None


_BANDAI = "https://github.com/BandaiNamcoResearchInc/Bandai-Namco-Research-Motiondataset"

DATASETS: dict[str, Dataset] = {
    "bandai-namco-2": Dataset(
        name="bandai-namco-2",
        title="Bandai-Namco-Research-Motiondataset-2",
        url=f"{_BANDAI}/archive/74ead3ba1ae4696404e6086233779f60de8bf9ef.zip",
        folder="Bandai-Namco-Research-Motiondataset-2",
        licence="CC-BY-NC-4.0",
        credit=f"Copyright Bandai Namco Research Inc., {_BANDAI}",
    )
}


def register_dataset(dataset: Dataset) -> None:
    """Add a data set, e.g. from a module that ``QUESTSIM_EXTENSIONS`` names.

    Raises:
        InputError: the name is taken or invalid, or the manifest or test list is missing.
    """
    name = dataset.name
    if DATASETS.get(name, dataset) != dataset:
        raise InputError(f"there is a data set {name!r} already", "register_dataset", "rename it")
    if not re.fullmatch(r"[\w.-]+", name) or name == "synthetic":
        raise InputError(f"{name!r} cannot name a data set", "register_dataset")
    for file in (f"{name}.sha256.gz", f"{name}-test.txt"):
        if not ((dataset.data or DATA) / file).is_file():
            raise InputError(f"there is no {file}", dataset.data or DATA, "write_manifest makes it")
    DATASETS[name] = dataset


def write_manifest(dataset: Dataset, archive: Path, test: Collection[str]) -> None:
    """Write the manifest and the test list of a new data set into its folder ``data``.

    Args:
        dataset: the data set, not yet registered.
        archive: a zip file that holds the motion files in the data set's ``folder``.
        test: names of the test clips: their files' names without ending.

    Raises:
        InputError: there are no motion files, two have one name, or a test clip is not among them.
    """
    digests: dict[str, str] = {}
    with zipfile.ZipFile(archive) as outer:
        for name, content in _members(outer, dataset):
            if Path(name).suffix.lower() not in FORMATS:
                continue
            if Path(name).stem in {Path(other).stem for other in digests}:
                raise InputError(f"two files are named {name}", archive, "rename one")
            digests[name] = hashlib.sha256(content()).hexdigest()
    if not digests:
        what = f"no {' or '.join(FORMATS)} files in a folder {dataset.folder!r}"
        raise InputError(what, archive, "name the archive's own folder in the Dataset")
    missing = sorted(set(test) - {Path(name).stem for name in digests})
    if missing:
        first = ", ".join(sorted(Path(name).stem for name in digests)[:5])
        raise InputError(f"no clip {missing[0]!r}", archive, f"its clips: {first}, ...")
    data = dataset.data or DATA
    lines = "".join(f"{digest}  {name}\n" for name, digest in sorted(digests.items()))
    _write(data / f"{dataset.name}.sha256.gz", gzip.compress(lines.encode(), mtime=0))
    _write(data / f"{dataset.name}-test.txt", "".join(f"{n}\n" for n in sorted(test)).encode())


def _data(name: str) -> Path:
    return DATASETS[name].data or DATA


@lru_cache
def manifest(name: str) -> dict[str, str]:
    """SHA-256 of each clip's file, by file name, of the dataset."""
    with gzip.open(_data(name) / f"{name}.sha256.gz", "rt", encoding="ascii") as file:
        pairs = (line.split() for line in file)
        return {filename: digest for digest, filename in pairs}


def split_names(name: str, split: str | None) -> list[str]:
    """Names of the dataset's clips, sorted: all, or those of ``"train"`` or ``"test"``.

    Raises:
        InputError: there is no such split.
    """
    if split not in (None, *SPLITS):
        raise InputError(f"no split {split!r} of {name}", fix=f"choose one of {', '.join(SPLITS)}")
    stems = sorted(Path(filename).stem for filename in manifest(name))
    if split is None:
        return stems
    test = set((_data(name) / f"{name}-test.txt").read_text(encoding="ascii").split())
    return [stem for stem in stems if (stem in test) == (split == "test")]


def dataset_folder(name: str) -> Path:
    """Where the dataset's clips are unpacked."""
    return cache_dir() / "datasets" / name


def is_fetched(name: str) -> bool:
    """Whether the whole dataset has been fetched and verified."""
    marker = dataset_folder(name) / _MARKER
    return marker.is_file() and marker.read_text(encoding="ascii") == manifest_digest(name)


def clip_files(name: str) -> list[Path]:
    """The dataset's files, sorted.

    Raises:
        InputError: it has not been fetched, or files have been removed since.
    """
    folder = dataset_folder(name)
    files = [folder / filename for filename in sorted(manifest(name))]
    if not is_fetched(name) or not all(file.is_file() for file in files):
        raise InputError(
            f"dataset {name} has not been fetched",
            fix=f"run: questsim motions fetch {name} [--mirror FILE]",
        )
    return files


def manifest_digest(name: str) -> str:
    """SHA-256 of the manifest; it identifies the content of all clips."""
    text = "".join(f"{digest}  {file}\n" for file, digest in sorted(manifest(name).items()))
    return hashlib.sha256(text.encode()).hexdigest()


_MARKER = "verified.sha256"


def fetch(name: str, mirror: str | None = None) -> Path:
    """Downloads a dataset, verifies every clip and unpacks it into the cache.

    Verified clips are kept; a downloaded archive that was not fully unpacked is reused.

    Args:
        name: a key of ``DATASETS``.
        mirror: a zip file or URL laid out as the public archive is, instead of the public one.

    Returns:
        The folder with the clips.

    Raises:
        InputError: there is no such dataset, the archive cannot be downloaded or read, or a clip
            is missing from it or differs from the manifest.
    """
    dataset = dataset_named(name)
    folder = dataset_folder(name)
    print(f"{dataset.title}: licence {dataset.licence}. {dataset.credit}")
    wanted = {f: d for f, d in manifest(name).items() if file_digest(folder / f) != d}
    kept = len(manifest(name)) - len(wanted)
    if wanted:
        archive, downloaded = _archive(dataset, mirror)
        try:
            _unpack(archive, dataset, wanted, folder)
        except zipfile.BadZipFile:
            if downloaded:
                archive.unlink(missing_ok=True)
            raise InputError("is damaged or not a zip archive", archive, "fetch again") from None
        if downloaded:
            archive.unlink(missing_ok=True)
    _write(folder / _MARKER, manifest_digest(name).encode())
    print(f"{len(manifest(name))} clips verified in {folder} ({kept} were there already)")
    return folder


def dataset_named(name: str) -> Dataset:
    """The dataset of that name; InputError where there is none."""
    if name not in DATASETS:
        raise InputError(f"no dataset {name!r}", fix=f"known are {', '.join(DATASETS)}")
    return DATASETS[name]


def _archive(dataset: Dataset, mirror: str | None) -> tuple[Path, bool]:
    """The zip file, and whether it was downloaded here and is removed after use."""
    url = mirror or dataset.url
    scheme = urlparse(url).scheme
    if scheme == "file":
        url, scheme = url2pathname(urlparse(url).path), ""
    if scheme not in ("http", "https"):
        if not Path(url).is_file():
            raise InputError("no such mirror file", url)
        return Path(url), False
    import pooch  # late: it imports what downloads over the network need

    folder = cache_dir() / "downloads"
    # Each mirror has its own file name, so that partial downloads are not mixed up.
    file = f"{dataset.name}-{hashlib.sha256(url.encode()).hexdigest()[:12]}.zip"
    try:
        # GitHub's archives are not byte-identical each time: the clips are verified instead.
        got = pooch.retrieve(
            url,
            known_hash=None,
            fname=file,
            path=folder,
            downloader=pooch.HTTPDownloader(progressbar=True, timeout=60),  # type: ignore[arg-type]
        )
    except Exception as error:  # requests' own exceptions, OSError, ValueError
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"download failed ({reason})", url, "try again, or give --mirror FILE_OR_URL"
        ) from None
    return Path(got), True


def _unpack(archive: Path, dataset: Dataset, wanted: dict[str, str], folder: Path) -> None:
    """Writes all wanted clips with the right digest; then rejects the archive if any failed."""
    from tqdm import tqdm

    found, wrong = set(), []
    with zipfile.ZipFile(archive) as outer:
        _make(folder)
        members = tqdm(_members(outer, dataset), total=None, unit=" files", disable=None)
        for filename, content in members:
            if filename in wanted and filename not in found:
                data = content()
                if hashlib.sha256(data).hexdigest() != wanted[filename]:
                    wrong.append(filename)
                    continue
                found.add(filename)
                _write(folder / filename, data)
            elif filename in ("LICENSE", "README.md"):
                _write(folder / filename, content())
    missing = sorted(set(wanted) - found)
    if missing:
        what = "differ from the manifest" if wrong else "are missing"
        example = (sorted(wrong) or missing)[0]
        raise InputError(
            f"{len(wrong) or len(missing)} of {len(manifest(dataset.name))} clips {what}, "
            f"e.g. {example}",
            archive,
            "use another mirror or the public archive; what was right is kept",
        )


def _members(archive: zipfile.ZipFile, dataset: Dataset) -> Iterator[tuple[str, _Content]]:
    """File names and contents of the dataset's part of an archive, also inside its data.zip."""
    for info in archive.infolist():
        parts = PurePosixPath(info.filename).parts
        if info.is_dir() or dataset.folder not in parts:
            continue
        if parts[-1] == "data.zip":
            with zipfile.ZipFile(io.BytesIO(archive.read(info))) as inner:
                for member in inner.infolist():
                    if not member.is_dir():
                        name = PurePosixPath(member.filename).name
                        yield name, _Content(inner, member)
        else:
            yield parts[-1], _Content(archive, info)


@dataclass(frozen=True)
class _Content:
    """A member of a zip file, read when it is called."""

    archive: zipfile.ZipFile
    info: zipfile.ZipInfo

    def __call__(self) -> bytes:
        if self.info.file_size > MAX_MEMBER_BYTES:
            raise InputError(f"{self.info.filename} is too large", self.archive.filename)
        return self.archive.read(self.info)


def file_digest(path: Path) -> str:
    """SHA-256 of a file; empty where there is none."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return ""


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", folder) from None


def _write(path: Path, content: bytes) -> None:
    with whole_file(path) as fresh:
        fresh.write_bytes(content)
