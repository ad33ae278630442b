"""``questsim replay`` and ``questsim recordings show``: drive the avatar by recordings."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from agents.follower.calibration import POSES, Calibration
from agents.follower.follower import Follower
from agents.follower.options import CALIBRATION_S, FollowArgs, ReplayArgs, ShowRecordingArgs
from questsim import rotations as rot
from questsim.avatar_pose import AvatarPose
from questsim.devices import DeviceFrame
from questsim.errors import InputError
from questsim.evaluation_report import check_writable
from questsim.exporting.formats import FORMATS
from questsim.files import whole_file
from questsim.motion.clip import FPS, Clip
from questsim.motion.kinematics import clip_from_qpos
from questsim.recordings import DeviceRecording, read_recording
from questsim.stream_metrics import Track, stream_scores, track_of

_STEP_S, _MOVING_M_S, _LEAST_MOVING_S = 0.1, 0.4, 2.0
"""Time over which a speed is taken, least speed of a headset that moves, and for how long."""
_BACKWARDS = -0.5
"""Mean cosine between movement and gaze below which a user goes backwards."""
MOTION_SUFFIXES = tuple(f".{name}" for name in FORMATS)


def replay(args: ReplayArgs) -> None:
    """Replay a recording and print the result.

    Raises:
        InputError: a recording, agent or option cannot be used.
    """
    if args.out is not None:
        _check_out(args.out)
    track = followed(args)
    _print(stream_scores(track), track)
    if args.out is not None:
        _write(args.out, args, track)
        print(f"written to {args.out}")


def _check_out(path: Path) -> None:
    """Refuse a file that cannot be written, before the replay."""
    suffixes = (".json", ".mp4", *MOTION_SUFFIXES)
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{path.name} does not end in one of {', '.join(suffixes)}", "--out")
    if path.suffix.lower() == ".mp4":
        from questsim.viewing.gl import find_gl, missing_gl

        if find_gl() is None:
            raise InputError(missing_gl(), "--out")
    check_writable(path.parent)


def _write(path: Path, args: FollowArgs, track: Track) -> None:
    """Write the scores, the motion or a film, by the file's suffix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    suffix = path.suffix.lower()
    if suffix == ".json":
        write_scores(path, args, track)
    elif suffix == ".mp4":
        from questsim.viewing.films import clip_frames
        from questsim.viewing.video import write_video

        clip = performed_clip(track, args.file.name)
        write_video(path, clip_frames(clip, 640, 480, 1), FPS)
    else:
        from questsim.exporting import write_clip

        write_clip(path, performed_clip(track, path.stem))


def show_recording(args: ShowRecordingArgs) -> None:
    """Describe a recording, and write OUT/NAME.png and OUT/NAME.json.

    Raises:
        InputError: a recording, agent or option cannot be used.
    """
    from questsim.stream_plots import plot_signals

    check_writable(args.out)
    recording = read_recording(args.file, args.convention)
    count, seconds = len(recording.frames), recording.duration_s
    print(f"{count} frames, {seconds:.1f} s, {(count - 1) / max(seconds, 1e-9):.1f} Hz on average")
    for name in recording.devices:
        share = sum(name in frame.poses for frame in recording.frames) / count
        print(f"{name}: reports in {100 * share:.1f} % of the frames")
    track = followed(args, recording)
    _print(stream_scores(track), track)
    args.out.mkdir(parents=True, exist_ok=True)
    base = args.out / args.file.name.split(".")[0]
    with whole_file(base.with_suffix(".png")) as fresh:
        plot_signals(track, fresh)
    write_scores(base.with_suffix(".json"), args, track)
    print(f"written to {base}.png and {base}.json")


def followed(args: FollowArgs, recording: DeviceRecording | None = None) -> Track:
    """The avatar's motion on a recording, after the calibration.

    Raises:
        InputError: see ``replay``.
    """
    torch.set_num_threads(1)
    if args.pose not in POSES:
        raise InputError(f"is {args.pose!r}, not one of {', '.join(POSES)}", "--pose")
    recording = recording or read_recording(args.file, args.convention)
    if recording.calibration is not None and args.height is None:
        for option in ("pose", "calibrate"):
            if getattr(args, option) != getattr(FollowArgs, option):
                raise InputError(
                    "does nothing: the recording has a calibration", f"--{option}",
                    "leave it out, or give --height to calibrate anew",
                )  # fmt: skip
    if moves_backwards(recording.frames):
        print(
            "warning: the headset moves against its gaze most of the time: are the axes those of "
            "another convention (docs/live.md)?",
            file=sys.stderr,
        )
    follower = Follower(args.agent, args.sensors, assist_n=args.assist)
    rest = calibrated(follower, recording, args.calibrate, args.height, args.pose)
    assert follower.calibration is not None
    known = follower.calibration
    print(f"stature {known.height_m:.2f} m, floor at {known.floor_m:.2f} m", file=sys.stderr)
    return track_of([known.apply(f) for f in rest], replayed(follower, rest), known.floor_m)


def moves_backwards(frames: Sequence[DeviceFrame]) -> bool:
    """Whether the headset moves against its gaze most of the time, as with axes of a wrong hand.

    Positions and quaternions of Unity that are read as OpenXR's look right while the user stands,
    but turn every step forward into one backwards.

    Args:
        frames: of a user; only those of a headset that moves count, in all for two seconds.
    """
    seen = [(f.time_s, f.poses["headset"]) for f in frames if "headset" in f.poses]
    times = np.array([time_s for time_s, _ in seen])
    place = np.array([pose.position[:2] for _, pose in seen]).reshape(-1, 2)
    gaze = rot.heading(np.array([pose.quat for _, pose in seen]).reshape(-1, 4))
    later = np.minimum(np.searchsorted(times, times + _STEP_S), len(times) - 1)
    passed_s = times[later] - times
    speed = (place[later] - place) / np.maximum(passed_s, 1e-9)[:, None]
    fast = np.linalg.norm(speed, axis=-1)
    moving = (passed_s < 2.0 * _STEP_S) & (fast > _MOVING_M_S)
    if np.minimum(np.diff(times, append=times[-1:]), _STEP_S)[moving].sum() < _LEAST_MOVING_S:
        return False
    ahead = (speed * np.stack([np.cos(gaze), np.sin(gaze)], axis=-1)).sum(axis=-1)
    return bool((ahead[moving] / fast[moving]).mean() < _BACKWARDS)


def calibrated(
    follower: Follower,
    recording: DeviceRecording,
    seconds: float = CALIBRATION_S,
    height_m: float | None = None,
    pose: str = "hanging",
) -> Sequence[DeviceFrame]:
    """Calibrate a follower by a recording; returns the frames to follow.

    Args:
        follower: gets the recording's calibration, or one from its first seconds.
        recording: the frames.
        seconds: length of the calibration; 0 for none, which needs a stature. It is repeated, as
            live, until the user stands still.
        height_m: stature, if known.
        pose: see ``calibrate``.

    Raises:
        InputError: the user never stands still, or the stature is unknown.
    """
    frames = recording.frames
    if recording.calibration is not None and height_m is None:
        follower.use(Calibration.of(recording.calibration, "calibration of the recording"))
        return frames
    if seconds <= 0.0:
        if height_m is None:
            raise InputError("the user's height is unknown", "--calibrate 0", "give --height")
        follower.use(Calibration(height_m))
        return frames
    return _measured(follower, frames, seconds, height_m, pose)


def _measured(
    follower: Follower,
    frames: Sequence[DeviceFrame],
    seconds: float,
    height_m: float | None,
    pose: str,
) -> Sequence[DeviceFrame]:
    """Calibrate on the first whole part in which the user stands still, as a live session does.

    Returns:
        The frames after that part.

    Raises:
        InputError: there is none; says what was wrong with the first part.
    """
    times = np.array([frame.time_s for frame in frames])
    begin, first_error = 0, None
    while begin < len(frames):
        end = int(np.searchsorted(times, times[begin] + seconds))
        if first_error is not None and end == len(frames):
            break
        try:
            follower.calibrate(frames[begin:end], height_m=height_m, pose=pose)
        except InputError as error:
            first_error = first_error or error
            begin = end + 1  # live, the frame that ends a part is in none
            continue
        if first_error is not None:
            after_s = times[begin] - times[0]
            print(f"calibrated after {after_s:.1f} s: {first_error.what} before", file=sys.stderr)
        return frames[end:]
    assert first_error is not None
    raise first_error


def replayed(follower: Follower, frames: Sequence[DeviceFrame]) -> list[AvatarPose]:
    """The avatar's pose after every frame."""
    return [follower.step(frame) for frame in frames]


def write_scores(path: Path, args: FollowArgs, track: Track) -> None:
    """Write scores, events and their source as JSON."""
    content = {
        "format": "questsim-stream-scores",
        "version": 1,
        "recording": args.file.name,
        "agent": args.agent,
        "assist_bound_n": args.assist,
        "height_m": track.height_m,
        "scores": stream_scores(track),
        "events": [{"time_s": round(time, 3), "event": text} for time, text in track.events],
    }
    with whole_file(path) as fresh:
        fresh.write_text(json.dumps(content, indent=1) + "\n")


def _print(scores: dict[str, float | int | None], track: Track) -> None:
    width = max(map(len, scores))
    for name, value in scores.items():
        shown = "-" if value is None else f"{value:.2f}" if isinstance(value, float) else value
        print(f"{name:<{width}}  {shown}")
    for time_s, event in track.events:
        print(f"{time_s:8.2f} s  {event}")


def performed_clip(track: Track, name: str) -> Clip:
    """The avatar's motion as a clip at 36 Hz."""
    return clip_from_qpos(name, track.qpos, track.height_m)
