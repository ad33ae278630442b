"""The users of a session's clips as they were recorded, from which devices are read."""

from __future__ import annotations

from collections.abc import Sequence

from questsim.motion.clip import Clip
from questsim.motion.motion import Motion


class Recordings:
    """Motions of clips by name; they are loaded when the first one is asked for.

    Args:
        motions: the motion argument that the clips are of.
        clips: those that can be asked for.
        seed: of the synthetic ones.
    """

    def __init__(self, motions: str, clips: Sequence[Clip], seed: int = 0) -> None:
        self._motions, self._seed = motions, seed
        self._clips = {clip.name: clip for clip in clips}
        self._loaded: dict[str, Motion] | None = None

    def __call__(self, name: str) -> Motion:
        """The motion as recorded; that of the avatar where nothing was, as of synthetic clips."""
        from questsim.motion.retarget_back import to_motion

        clip = self._clips[name]
        if not clip.source_sha256:
            return to_motion(clip)
        if self._loaded is None:
            from questsim.motion.spec import load_recordings

            recorded = load_recordings(self._motions, seed=self._seed)
            self._loaded = {
                motion.name: motion for motion in recorded if motion.name in self._clips
            }
        return self._loaded[name] if name in self._loaded else to_motion(clip)
