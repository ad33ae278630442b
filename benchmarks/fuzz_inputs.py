"""Small whole inputs of every kind, and the readers that they are for."""

from __future__ import annotations

import gzip
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

Files = dict[str, bytes]
"""Contents by name; the reader is given the first."""
FRAMES = 6


@dataclass(frozen=True)
class Reader:
    """What is fuzzed.

    Attributes:
        name: of the reader.
        inputs: whole inputs; one is chosen for each case.
        read: what a user's command does with the input.
    """

    name: str
    inputs: Callable[[], list[Files]]
    read: Callable[[Path], Any]

    def prepare(self) -> None:
        """Read every whole input, which also imports and compiles what is needed.

        Raises:
            InputError: a whole input is refused.
        """
        for files in self.inputs():
            with TemporaryDirectory(prefix="whole") as folder:
                for name, content in files.items():
                    path = Path(folder, name)
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(content)
                self.read(Path(folder, next(iter(files))))


def _skeleton() -> tuple[list[str], list[int], np.ndarray]:
    """Names, parents and offsets in metres, y up, of a person 1.75 m tall."""
    from questsim.motion.amass import SMPL_NAMES, SMPL_PARENTS, mean_offsets

    return list(SMPL_NAMES), list(SMPL_PARENTS), 1.75 * mean_offsets()


@cache
def bvh() -> list[Files]:
    """A BVH with SMPL's names, and one of names that have to be recognised, in centimetres."""
    names, parents, offsets = _skeleton()
    plain = _bvh(names, parents, offsets)
    other = [_spelt(name) for name in names]
    return [{"walk.bvh": plain}, {"walk.bvh": _bvh(other, parents, 100 * offsets)}]


def _spelt(name: str) -> str:
    side, _, part = name.rpartition("_")
    part = {"Ankle": "Foot", "Knee": "Leg", "Hip": "UpLeg", "Foot": "Toe", "Wrist": "Hand",
            "Elbow": "ForeArm", "Shoulder": "Arm", "Collar": "Clavicle", "Pelvis": "Hips"}.get(
                part, part)  # fmt: skip
    return f"mixamorig:{ {'L': 'Left', 'R': 'Right', '': ''}[side] }{part}"


def _bvh(names: list[str], parents: list[int], offsets: np.ndarray) -> bytes:
    lines, order = ["HIERARCHY"], []

    def joint(index: int, depth: int) -> None:
        pad = "  " * depth
        order.append(index)
        x, y, z = offsets[index]
        channels = "Xposition Yposition Zposition " if index == 0 else ""
        lines.append(f"{pad}{'JOINT' if index else 'ROOT'} {names[index]}")
        lines.append(f"{pad}{{\n{pad}  OFFSET {x:.4f} {y:.4f} {z:.4f}")
        count = 6 if index == 0 else 3
        lines.append(f"{pad}  CHANNELS {count} {channels}Zrotation Xrotation Yrotation")
        children = [i for i, parent in enumerate(parents) if parent == index]
        for child in children:
            joint(child, depth + 1)
        if not children:
            lines.append(f"{pad}  End Site\n{pad}  {{\n{pad}    OFFSET 0 0.02 0.02\n{pad}  }}")
        lines.append(f"{pad}}}")

    joint(0, 0)
    lines += ["MOTION", f"Frames: {FRAMES}", "Frame Time: 0.0333333"]
    height = 0.98 * abs(offsets).max() / abs(_skeleton()[2]).max()
    for frame in range(FRAMES):
        turns = [f"{3 * np.sin(frame + i):.3f} 0 0" for i in range(len(order))]
        lines.append(f"0.0 {height:.4f} {0.01 * frame:.4f} {' '.join(turns)}")
    return "\n".join(lines).encode() + b"\n"


_ACCLAIM = {
    "Pelvis": "root", "Spine1": "lowerback", "Spine2": "upperback", "Spine3": "thorax",
    "Neck": "lowerneck", "Head": "head", "Hip": "femur", "Knee": "tibia", "Ankle": "foot",
    "Foot": "toes", "Collar": "clavicle", "Shoulder": "humerus", "Elbow": "radius",
    "Wrist": "wrist",
}  # fmt: skip


@cache
def amc() -> list[Files]:
    """An AMC with its ASF. A bone there is what begins at the joint."""
    names, parents, offsets = _skeleton()
    theirs = [n[0].lower() + _ACCLAIM[n[2:]] if n[1] == "_" else _ACCLAIM[n] for n in names]
    asf = [
        "# a person", ":version 1.10", ":units", "  mass 1.0", "  length 0.45", "  angle deg",
        ":root", "   order TX TY TZ RX RY RZ", "   axis XYZ", "   position 0 0 0",
        "   orientation 0 0 0", ":bonedata",
    ]  # fmt: skip
    # Bones from the root to the hips, which have no joint of their own.
    bones = [(f"{s}hipjoint", offsets[names.index(f"{s.upper()}_Hip")]) for s in "lr"]
    for index, name in enumerate(theirs[1:], 1):
        below = [i for i, parent in enumerate(parents) if parent == index]
        bones.append((name, offsets[below[0]] if below else np.array([0.0, 0.05, 0.02])))
    for index, (name, bone) in enumerate(bones, 1):
        length = float(np.linalg.norm(bone))
        x, y, z = bone / length
        asf += [
            "  begin", f"    id {index}", f"    name {name}",
            f"    direction {x:.6f} {y:.6f} {z:.6f}", f"    length {length / 0.0254 * 0.45:.5f}",
            "    axis 0 0 0 XYZ", "    dof rx ry rz", "    limits (-180 180)",
            "           (-180 180)", "           (-180 180)", "  end",
        ]  # fmt: skip
    asf += [":hierarchy", "  begin"]
    for index, name in enumerate(theirs):
        below = [theirs[i] for i, parent in enumerate(parents) if parent == index]
        below = [b[0] + "hipjoint" if b.endswith("femur") else b for b in below]
        if below:
            asf.append(f"    {name} {' '.join(below)}")
        if index == 0:
            asf += ["    lhipjoint lfemur", "    rhipjoint rfemur"]
    asf.append("  end")
    motion = ["#!OML:ASF person.asf", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(1, FRAMES + 1):
        motion += [str(frame), f"root 0 {0.98 / 0.0254 * 0.45:.4f} 0 0 0 0"]
        motion += [f"{name} {0.1 * frame:.2f} 0 0" for name, _ in bones]
    return [{"p_1.amc": "\n".join(motion).encode(), "p.asf": "\n".join(asf).encode()}]


@cache
def deepmimic() -> list[Files]:
    """DeepMimic's JSON."""
    turn, row = [1.0, 0.0, 0.0, 0.0], []
    for count in (4, 4, 4, 4, 1, 4, 4, 1, 4, 1, 4, 4, 1):
        row += turn if count == 4 else [-0.1]
    frames = [[0.0333, 0.01 * i, 0.87, 0.0, *row] for i in range(FRAMES)]
    return [{"walk.json": json.dumps({"Loop": "wrap", "Frames": frames}, indent=1).encode()}]


@cache
def amass() -> list[Files]:
    """AMASS's two layouts."""
    poses = np.zeros((FRAMES, 72))
    poses[:, 0] = np.pi / 2  # z up
    poses[:, 6] = np.linspace(0.0, 0.2, FRAMES)
    rest: dict[str, Any] = {
        "trans": np.tile([0.0, 0.0, 0.95], (FRAMES, 1)),
        "betas": np.zeros(10),
        "mocap_framerate": np.array(60.0),
    }
    parts = {"root_orient": poses[:, :3], "pose_body": poses[:, 3:66]}
    return [{"walk.npz": _npz(poses=poses, **rest)}, {"walk.npz": _npz(**parts, **rest)}]


@cache
def smpl() -> list[Files]:
    """A SMPL model of 60 vertices, with a motion."""
    rng = np.random.default_rng(0)
    names, parents, offsets = _skeleton()
    places = offsets.copy()
    for index in range(1, len(names)):
        places[index] += places[parents[index]]
    vertices = np.zeros((60, 3))
    vertices[: len(names)] = places
    regressor = np.zeros((24, 60))
    regressor[range(22), range(22)] = 1.0
    model = _npz(
        J_regressor=regressor, v_template=vertices, shapedirs=0.001 * rng.normal(size=(60, 3, 10))
    )
    return [{"model.npz": model, "walk.npz": amass()[0]["walk.npz"]}]


@cache
def library() -> list[Files]:
    """A library of one motion."""
    from questsim.motion.library import save_library
    from questsim.motion.many import read_and_retarget
    from questsim.motion.reading import ReadOptions

    with TemporaryDirectory(prefix="library") as folder:
        path = Path(folder, "walk.bvh")
        path.write_bytes(bvh()[0]["walk.bvh"])
        done = read_and_retarget(path, ReadOptions())
        save_library(Path(folder, "lib.npz"), [done.motion], [done.clip])
        return [{"lib.npz": Path(folder, "lib.npz").read_bytes()}]


def _npz(**arrays: Any) -> bytes:
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


@cache
def policy() -> list[Files]:
    """A shipped policy's description, with networks of eight units."""
    import yaml
    from safetensors.torch import save

    from agents.policy.policy_agent import new_policy
    from agents.policy.spec import Layout, PolicySpec
    from agents.resolve import SHIPPED

    card = yaml.safe_load((SHIPPED / "demo" / "policy.yaml").read_text(encoding="utf-8"))
    card["network"]["hidden"] = [8, 8]
    card["training"] = {"steps": 1000}
    network: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in card["network"].items()
    }
    blocks = {name: (a, b) for name, (a, b) in card["observation"].items()}
    made = new_policy(PolicySpec(**network, critic_blocks=()), Layout(blocks))
    state = {k: v.contiguous() for k, v in made.state_dict().items() if not k.startswith("critic.")}
    text = yaml.safe_dump(card, sort_keys=False).encode()
    return [{"run/policy.yaml": text, "run/policy.safetensors": save(state)}]


@cache
def system() -> list[Files]:
    """A kinematic system of the smallest preset's sizes, untrained."""
    from agents.kinematic.registry import AGENTS
    from agents.kinematic.store import save_system

    found = []
    for name in ("hmdposer", "dragposer"):
        entry = AGENTS[name]
        spec = entry.presets["smoke"].spec
        with TemporaryDirectory(prefix="system") as folder:
            place = Path(folder, "run")
            save_system(place, entry.build(spec), name, spec, {"trained": []})
            names = ("system.yaml", "system.safetensors")
            found.append({f"run/{file}": (place / file).read_bytes() for file in names})
    return found


@cache
def run_record() -> list[Files]:
    """A run's record."""
    import yaml

    record = {
        "format": "questsim-run", "format_version": 1, "preset": "smoke", "seed": 0,
        "args": {"motions": "synthetic", "out": "runs/a", "steps": 1000, "env": None, "set": []},
        "data": {"motions": "synthetic", "clips": 12, "sha256": "0" * 64, "licences": ["CC0-1.0"]},
        "versions": {"questsim": "1.0", "numpy": "1.26"},
    }  # fmt: skip
    return [{"run/run.yaml": yaml.safe_dump(record, sort_keys=False).encode()}]


@cache
def mapping() -> list[Files]:
    """A mapping file for the BVH with it."""
    from questsim.motion.families import SMPL

    lines = ['name = "rig"', 'up = "y"', 'units = "m"', "foot_pitch = 0.1", "toe_pitch = 0.0"]
    lines += ['zero_axes = "z x y"', "feet_follow_shins = false", "[joints]"]
    lines += [f'{ours} = "{theirs}"' for ours, theirs in SMPL.joints.items()]
    lines += ["[axes]", 'head = "z x y"']
    return [{"rig.toml": "\n".join(lines).encode(), "walk.bvh": bvh()[0]["walk.bvh"]}]


@cache
def recording() -> list[Files]:
    """Recordings of devices in the three formats."""
    pose = [0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0]
    header = {
        "format": "questsim-recording", "version": 1, "convention": "openxr", "calibration": None
    }  # fmt: skip
    rows = [header] + [
        {"t": 0.0111 * i, "headset": pose, "left_controller": pose, "right_controller": pose}
        for i in range(FRAMES)
    ]
    own = "\n".join(map(json.dumps, rows)).encode()
    parts = ("x", "y", "z", "qx", "qy", "qz", "qw")
    names = ["time_s", *(f"headset_{part}" for part in parts)]
    table = [",".join(names)] + [",".join(map(str, (0.0111 * i, *pose))) for i in range(FRAMES)]
    source = {"handedness": "left", "targetRayMode": "tracked-pointer", "hasGrip": True}
    frames = [[11.1 * i, *pose, [0, pose, pose, pose, pose, pose, pose, pose, pose]]
              for i in range(FRAMES)]  # fmt: skip
    iwer = json.dumps({"schema": [[0, source]], "frames": frames}).encode()
    return [
        {"r.jsonl.gz": gzip.compress(own, 1, mtime=0)},
        {"r.csv": "\n".join(table).encode()},
        {"r.json": iwer},
    ]


@cache
def terrain() -> list[Files]:
    """Descriptions of ground."""
    texts = ("rough:amplitude_m=0.08,seed=3", "course:levels=2,tile_m=8,spread_m=1",
             "stairs:step_height_m=0.1,direction=up", "waves:wavelength_m=2,size_m=16",
             "slope:slope_deg=8", "gaps:gap_m=0.2")  # fmt: skip
    return [{"terrain.txt": text.encode()} for text in texts]


def _read_motion(path: Path) -> Any:
    from questsim.motion.many import read_and_retarget
    from questsim.motion.reading import ReadOptions

    return read_and_retarget(path, ReadOptions(), with_error=True)


def _read_smpl(path: Path) -> Any:
    from questsim.motion.many import read_and_retarget
    from questsim.motion.reading import ReadOptions

    return read_and_retarget(path.with_name("walk.npz"), ReadOptions(smpl_file=str(path)))


def _read_mapping(path: Path) -> Any:
    from questsim.motion.many import read_and_retarget
    from questsim.motion.reading import ReadOptions

    return read_and_retarget(path.with_name("walk.bvh"), ReadOptions(mapping=str(path)))


def _read_library(path: Path) -> Any:
    from questsim.motion.library import load_library

    return load_library(path)


def _read_policy(path: Path) -> Any:
    from agents.loading import load_agent

    return load_agent(path.parent)


def _read_system(path: Path) -> Any:
    from agents.kinematic.store import load_system

    return load_system(path.parent)


def _read_run(path: Path) -> Any:
    from agents.run_folder import read_run

    return read_run(path.parent)


def _read_recording(path: Path) -> Any:
    from questsim.recordings import read_recording

    return read_recording(path, "unity" if path.suffix == ".csv" else None)


def _read_terrain(path: Path) -> Any:
    from envs.terrain import terrain_named

    # What stands on a command line is text without null characters.
    return terrain_named(path.read_bytes().decode(errors="surrogateescape").replace("\0", ""))


READERS: dict[str, Reader] = {
    reader.name: reader
    for reader in (
        Reader("bvh", bvh, _read_motion),
        Reader("amc", amc, _read_motion),
        Reader("json", deepmimic, _read_motion),
        Reader("npz", amass, _read_motion),
        Reader("smpl", smpl, _read_smpl),
        Reader("library", library, _read_library),
        Reader("policy", policy, _read_policy),
        Reader("system", system, _read_system),
        Reader("run", run_record, _read_run),
        Reader("mapping", mapping, _read_mapping),
        Reader("recording", recording, _read_recording),
        Reader("terrain", terrain, _read_terrain),
    )
}
"""What is fuzzed, by name."""
