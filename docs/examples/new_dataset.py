"""A new data set: a zip of BVH files, its manifest, and the names of its test clips.

Write the manifest once and keep it beside your module. The module that ``QUESTSIM_EXTENSIONS``
names then has only the ``Dataset`` and the call of ``register_dataset``; ``questsim motions fetch
standing`` downloads the archive, and every command accepts ``--motions standing:train``.
"""

import tempfile
import zipfile
from pathlib import Path

from questsim.exporting.bvh_file import write_joint_bvh
from questsim.motion.clip import Clip
from questsim.motion.datasets import Dataset, fetch, register_dataset, write_manifest
from questsim.motion.spec import load_motions, load_recordings

FOLDER = Path(tempfile.mkdtemp())
ARCHIVE = FOLDER / "standing.zip"
STANDING = Dataset(
    name="standing", title="Standing people", url=ARCHIVE.as_uri(), folder="standing",
    licence="CC0-1.0", credit="written by this example", data=FOLDER,
)  # fmt: skip


def main() -> list[Clip]:
    """Make the archive from embedded motions, add the data set, fetch it, load a split."""
    with zipfile.ZipFile(ARCHIVE, "w") as archive:
        for motion in load_recordings("synthetic:stand"):
            write_joint_bvh(FOLDER / f"{motion.name}.bvh", motion)
            archive.write(FOLDER / f"{motion.name}.bvh", f"standing/{motion.name}.bvh")
    write_manifest(STANDING, ARCHIVE, test=["synthetic-stand-1"])
    register_dataset(STANDING)
    fetch("standing")
    return list(load_motions("standing:train"))


if __name__ == "__main__":
    print("training clips:", [clip.name for clip in main()])
