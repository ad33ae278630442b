"""How an input is damaged: its bytes, its words, its values, its arrays, its lines."""

from __future__ import annotations

import gzip
import io
import re
import zipfile
import zlib
from collections.abc import Callable
from random import Random

import numpy as np

NUMBERS = (
    b"0", b"-1", b"1", b"nan", b"NaN", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"1e13",
    b"-0.0", b"99999999999999999999", b"1" * 5000, b"0x10", b"1e5", b"1_000", b"2001-13-45", b"",
    b"true", b"null", b"~", b"[]", b"{}", b"''", b"- 1",
    b"!!python/object:os.system x", b"&a *a",
)  # fmt: skip
WORDS = (
    b"\x00", b"\xff\xfe", "\u30d2".encode(), "\u30d2".encode("shift_jis"), b"\xe9", b"\n\n", b"\r",
    b"{", b"}", b"[" * 3000, b"]", b":", b",", b'"', b"\t", b"#", b"MOTION", b"End Site",
    b" ", b"a" * 3000,
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][\w-]*")


def damage(content: bytes, name: str, rng: Random) -> bytes:
    """The content, damaged in one to three ways; a packed file also inside."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if name.endswith(".npz") and rng.random() < 0.75:
            content = _in_arrays(content, rng)
        elif name.endswith(".gz") and rng.random() < 0.75:
            content = _in_gzip(content, rng)
        elif name.endswith((".npz", ".gz", ".safetensors")):
            content = rng.choice(BYTES)(content, rng)
        else:
            content = rng.choice((*BYTES, *TEXT, *TEXT))(content, rng)
    return content


def _flip(content: bytes, rng: Random) -> bytes:
    out = bytearray(content)
    for _ in range(rng.choice((1, 1, 4, 64))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _cut(content: bytes, rng: Random) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _remove(content: bytes, rng: Random) -> bytes:
    start = rng.randrange(len(content) + 1)
    return content[:start] + content[start + rng.choice((1, 8, 100, 5000)) :]


def _insert(content: bytes, rng: Random) -> bytes:
    at = rng.randrange(len(content) + 1)
    return content[:at] + rng.choice(WORDS) + content[at:]


def _random(content: bytes, rng: Random) -> bytes:
    return (
        rng.randbytes(rng.choice((0, 1, 10, 1000))) if rng.random() < 0.3 else _flip(content, rng)
    )


def _replaced(pattern: re.Pattern[bytes], content: bytes, new: bytes, rng: Random) -> bytes:
    found = list(pattern.finditer(content))
    if not found:
        return content
    # The first matches are the header's, which matter most.
    hit = rng.choice(found[:60] if rng.random() < 0.6 else found)
    return content[: hit.start()] + new + content[hit.end() :]


def _number(content: bytes, rng: Random) -> bytes:
    return _replaced(_NUMBER, content, rng.choice(NUMBERS), rng)


def _word(content: bytes, rng: Random) -> bytes:
    words = _WORD.findall(content[:20_000])
    new = rng.choice(words) if words and rng.random() < 0.6 else rng.choice((*WORDS, *NUMBERS))
    return _replaced(_WORD, content, new, rng)


def _all_numbers(content: bytes, rng: Random) -> bytes:
    """Every number of a line, or of the file, the same or scaled."""
    lines = content.split(b"\n")
    chosen = range(len(lines)) if rng.random() < 0.4 else [rng.randrange(len(lines))]
    if rng.random() < 0.5:
        new = rng.choice(NUMBERS[:14])
        for i in chosen:
            lines[i] = _NUMBER.sub(lambda _: new, lines[i])
    else:
        factor = rng.choice((0.0, -1.0, 1e-6, 1e6, 1e150))
        for i in chosen:
            lines[i] = _NUMBER.sub(lambda m: repr(float(m[0]) * factor).encode(), lines[i])
    return b"\n".join(lines)


def _lines(content: bytes, rng: Random) -> bytes:
    """A line is left out, doubled, moved, repeated, or indented otherwise."""
    lines = content.split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    job = rng.randrange(5)
    if job == 0:
        del lines[a]
    elif job == 1:
        lines.insert(b, lines[a])
    elif job == 2:
        lines[a], lines[b] = lines[b], lines[a]
    elif job == 3:
        lines[a:a] = [lines[a]] * rng.choice((5, 500))
    else:
        lines[a] = b" " * rng.choice((1, 2, 7)) + lines[a].strip()
    return b"\n".join(lines)


def _nested(content: bytes, rng: Random) -> bytes:
    depth = rng.choice((50, 2000, 100_000))
    return _replaced(_NUMBER, content, b"[" * depth + b"]" * depth, rng)


BYTES: tuple[Callable[[bytes, Random], bytes], ...] = (_flip, _cut, _remove, _insert, _random)
TEXT: tuple[Callable[[bytes, Random], bytes], ...] = (
    _number, _number, _word, _all_numbers, _lines, _lines, _nested,
)  # fmt: skip


def _in_gzip(content: bytes, rng: Random) -> bytes:
    try:
        text = gzip.decompress(content)
    except (OSError, EOFError, ValueError, zlib.error):
        return _flip(content, rng)
    return gzip.compress(rng.choice((*BYTES, *TEXT, *TEXT))(text, rng), 1, mtime=0)


def _in_arrays(content: bytes, rng: Random) -> bytes:
    """An .npz with one array left out, renamed, reshaped, retyped or with other values."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            members = {entry.filename: file.read(entry) for entry in file.infolist()}
    except Exception:  # earlier damage: zipfile and zlib raise many kinds
        return _flip(content, rng)
    if not members:
        return content
    name = rng.choice(sorted(members))
    if rng.random() < 0.15:
        members[name] = rng.choice(BYTES)(members[name], rng)
    elif rng.random() < 0.15:
        members[rng.choice((*members, "fps.npy", "x", "../y.npy"))] = members.pop(name)
    else:
        try:
            array = np.load(io.BytesIO(members[name]))
        except Exception:  # earlier damage
            return _flip(content, rng)
        with np.errstate(all="ignore"):
            members[name] = _saved(_array(array, rng))
    out = io.BytesIO()
    packing = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(out, "w", packing) as file:
        for key, data in members.items():
            file.writestr(zipfile.ZipInfo(key), data, packing)
    return out.getvalue()


def _saved(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def _array(array: np.ndarray, rng: Random) -> np.ndarray:
    job = rng.randrange(8)
    if job == 0:
        return array[: rng.choice((0, 1, 2))] if array.ndim else array[None]
    if job == 1:
        return array[..., : rng.choice((0, 1, 2))] if array.ndim else array.reshape(1, 1)
    if job == 2:
        shape = rng.choice(((0,), (1, -1), (-1,), (-1, 1), (1, 1, -1)))
        return array.reshape(shape) if array.size and shape != (0,) else np.zeros(0, array.dtype)
    if job == 3:
        kind = rng.choice(
            ("f2", "f4", "i1", "i8", "u1", "?", "U3", "S4", "O", "c16", ">f8", "M8[s]")
        )
        try:
            return array.astype(kind)
        except (ValueError, TypeError):
            return np.array(["x", None], object)
    if job == 4 or array.dtype.kind not in "fiu" or not array.size:
        return np.resize(array, rng.choice(((0, 66), (3,), (100_000,), (2, 3), ())))
    if job == 5:
        return array * rng.choice((0, -1, 1e-6, 1e6, 1e300, float("nan")))
    out = array.astype(float)
    for _ in range(rng.choice((1, 1, 20))):
        out.reshape(-1)[rng.randrange(out.size)] = rng.choice(
            (0.0, -1.0, 1e5, 1e13, 1e308, 1e-320, float("nan"), float("inf"), 7.0)
        )
    return out if rng.random() < 0.7 else out.astype(array.dtype)
