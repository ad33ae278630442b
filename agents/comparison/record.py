"""The results of a comparison clip by clip, so that an interrupted one can continue.

``clips.jsonl`` in the folder: one line for what is compared, then one line for each clip of each
row as soon as it is scored. The same command reads them again and computes only what is missing.
Each line has a digest of its agent: results of other weights are not used, and agents may be added.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from agents.comparison.summary import Summary
from questsim.errors import InputError

FILE = "clips.jsonl"


class Record:
    """The file of a comparison; also a context that closes it.

    Args:
        folder: of the comparison.
        what: everything that all results depend on, as plain values.
        agents: digest of each agent.

    Raises:
        InputError: the folder has the results of something else, or the file is damaged.
    """

    def __init__(self, folder: Path, what: dict[str, Any], agents: dict[str, str]) -> None:
        self.path, self._agents = folder / FILE, agents
        self._found: dict[tuple[str, str], Summary] = {}
        what = json.loads(json.dumps(what))
        if self.path.exists():
            self._read(what)
            self._file = self.path.open("a", encoding="utf-8")
        else:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("w", encoding="utf-8")
            self._write(what)

    def _read(self, what: dict[str, Any]) -> None:
        """Read complete lines; a last line that Ctrl-C cut off is removed."""
        try:
            text = self.path.read_text(encoding="utf-8")
            whole = text[: text.rfind("\n") + 1]
            lines = [json.loads(line) for line in whole.splitlines()]
            found, entries = dict(lines[0]), lines[1:]
            for entry in entries:
                row, summary = entry["row"], Summary(**entry["summary"])
                if entry["agent"] == self._digest(row):
                    self._found[row, entry["clip"]] = summary
        except (ValueError, IndexError, KeyError, TypeError) as error:
            raise InputError("is damaged", self.path, "remove it to start again") from error
        if found != what:
            off = sorted(key for key in {*found, *what} if found.get(key) != what.get(key))
            raise InputError(
                f"has the results of another comparison (other {', '.join(off)})",
                self.path,
                "choose another --out, or remove the file to start again",
            )
        if whole != text:
            self.path.write_text(whole, encoding="utf-8")

    def _digest(self, row: str) -> str | None:
        """Digest of the agent of a row, ``AGENT: SCENARIO``; None if it is not compared."""
        return self._agents.get(row.partition(": ")[0])

    def _write(self, entry: dict[str, Any]) -> None:
        self._file.write(json.dumps(entry) + "\n")
        self._file.flush()

    def add(self, row: str, clip: str, summary: Summary) -> None:
        """Store the results of one clip in one row."""
        if (row, clip) not in self._found:
            self._found[row, clip] = summary
            entry = {"row": row, "clip": clip, "agent": self._digest(row)}
            self._write({**entry, "summary": summary.to_json()})

    def missing(self, rows: Iterable[str], clips: Sequence[str]) -> list[int]:
        """Indices of the clips that at least one of the rows does not have."""
        rows = list(rows)
        return [
            i for i, clip in enumerate(clips) if any((row, clip) not in self._found for row in rows)
        ]

    def of(self, row: str, clips: Sequence[str]) -> list[Summary]:
        """The results of a row, in the order of its clips."""
        return [self._found[row, clip] for clip in clips]

    def __enter__(self) -> Record:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
