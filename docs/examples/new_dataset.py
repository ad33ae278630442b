"""A new data set: a zip of BVH files, its manifest, and the names of its test clips.

With ``QUESTSIM_EXTENSIONS=docs.examples.new_dataset``, ``questsim motions fetch standing`` fetches
it. If archive and manifest exist already, only ``Dataset`` and ``register_dataset`` are needed.
"""

import zipfile

from questsim.exporting.bvh_file import write_joint_bvh
from questsim.motion.cache import cache_dir
from questsim.motion.clip import Clip
from questsim.motion.datasets import Dataset, fetch, register_dataset, write_manifest
from questsim.motion.spec import load_motions, load_recordings

FOLDER = (cache_dir() / "example-standing").absolute()
ARCHIVE = FOLDER / "standing.zip"
STANDING = Dataset(
    name="standing", title="Standing people", url=ARCHIVE.as_uri(), folder="standing",
    licence="CC0-1.0", credit="written by this example", data=FOLDER,
)  # fmt: skip

if not (FOLDER / "standing-test.txt").exists():  # once, from embedded motions
    FOLDER.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(ARCHIVE, "w") as archive:
        for motion in load_recordings("synthetic:stand"):
            write_joint_bvh(FOLDER / f"{motion.name}.bvh", motion)
            archive.write(FOLDER / f"{motion.name}.bvh", f"standing/{motion.name}.bvh")
    write_manifest(STANDING, ARCHIVE, test=["synthetic-stand-1"])
register_dataset(STANDING)


def main() -> list[Clip]:
    """Download the data set and load a split."""
    fetch("standing")
    return list(load_motions("standing:train"))


if __name__ == "__main__":
    print("training clips:", [clip.name for clip in main()])
