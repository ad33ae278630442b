"""The page of ``questsim live`` in Chromium with an emulated headset, against an offline replay.

    python -m benchmarks.live_page --seconds 12 --agent questsim-now

The shipped recording drives the page, one row a frame. Targets: every row arrives, and the mean
error of the devices is within 1 cm of that of the same rows without a page.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from agents.follower import Follower
from agents.headset.command import ASSIST_N
from agents.headset.session import WAITING, LiveSession
from benchmarks.common import arguments, report
from questsim.cli import guarded
from questsim.devices import DeviceFrame
from questsim.errors import InputError
from questsim.recordings import read_recording
from tests.browser import missing, new_browser
from tests.emulated_headset import polled, rows_of, running, wear, why_no_page


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", {"agent": "questsim-now"}, seconds=12)
    torch.set_num_threads(1)
    if fault := why_no_page(missing()):
        raise InputError(fault, "benchmarks.live_page", "make page")
    recording = read_recording(Path("synthetic"))
    end = recording.frames[0].time_s + args.seconds
    report(measure(args.agent, [f for f in recording.frames if f.time_s < end]), args.json)


def measure(agent: str, frames: Sequence[DeviceFrame]) -> dict[str, float]:
    """Rows that arrived, and errors of the devices in cm with and without the page.

    Args:
        agent: follows.
        frames: calibration and motion of a user.
    """
    rows = rows_of(frames)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "came.jsonl.gz"
        words = ("--agent", agent, "--record", str(out))
        began = time.monotonic()
        with running(*words) as address, new_browser(160, 120) as context:
            tab, texts = context.pages[0], list[str]()

            def hear(socket: Any, texts: list[str] = texts) -> None:
                socket.on("framereceived", lambda text: texts.append(text))

            tab.on("websocket", hear)
            wear(tab, address, rows)
            polled(tab, f"window.lastPose?.seen >= {rows[-1]['t'] - 1e-3}", 120.0)
        seconds = time.monotonic() - began
        came = read_recording(out).frames
    shown = errors(json.loads(text) for text in texts)
    return {
        "rows": len(rows),
        "rows_that_arrived": len(came),
        "poses_on_the_page": len(shown),
        "times_real_time": (frames[-1].time_s - frames[0].time_s) / seconds,
        "error_cm_on_the_page": float(np.mean(shown)),
        "error_cm_offline": float(np.mean(offline(agent, came))),
    }


def errors(messages: Any) -> list[float]:
    """Errors of the devices in cm that messages of the server tell."""
    return [m["error_cm"] for m in messages if m["type"] == "pose" and m["error_cm"] is not None]


def offline(agent: str, frames: Sequence[DeviceFrame]) -> list[float]:
    """The same figures when every frame is taken at once, and none is dropped."""
    told: list[dict[str, Any]] = []
    with LiveSession(Follower(agent, assist_n=ASSIST_N), told.append) as session:
        session.begin()
        while session.state == WAITING:
            time.sleep(0.01)
        for number, frame in enumerate(frames):
            while session.taken < number:
                time.sleep(0.0005)
            session.push(frame)
    return errors(told)


if __name__ == "__main__":
    sys.exit(guarded(main))
