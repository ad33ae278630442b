"""The recorded users of a session's clips; device signals are made from them."""

from __future__ import annotations

from collections.abc import Sequence

from questsim.motion.clip import Clip
from questsim.motion.motion import Motion


class Recordings:
    """Motions of clips by name; they are loaded at the first request.

    Args:
        motions: the motion argument that the clips come from.
        clips: the available clips.
        seed: seed of the synthetic motions.
    """

    def __init__(self, motions: str, clips: Sequence[Clip], seed: int = 0) -> None:
        self._motions, self._seed = motions, seed
        self._clips = {clip.name: clip for clip in clips}
        self._loaded: dict[str, Motion] | None = None

    def __call__(self, name: str) -> Motion:
        """The recorded motion; the avatar's if there is no recording, as for synthetic clips."""
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
