"""Environment steps/s on each terrain over those on a plane, in one run.

    python -m benchmarks.terrain_throughput [--json] [--envs 128] [--threads 2] [--steps 60]

All batches are stepped in turn under springs that hold the joints near zero, and are reset when
they fall. Each figure is the median ratio of single steps, so that a change of clock or another
process affects both sides equally.
"""

from __future__ import annotations

import statistics
import time

from benchmarks.common import arguments, clips, report, springs
from envs import EnvConfig, QuestVecEnv, WorldObject
from envs.terrain import TERRAINS

WARM_UP = 10


def main() -> None:
    """Measure and print."""
    args = arguments(__doc__ or "", envs=128, threads=2, steps=60)
    worlds = {f"{name}_to_plane": EnvConfig(terrain=ground) for name, ground in TERRAINS.items()}
    worlds["height_scan_to_plane"] = EnvConfig(terrain=TERRAINS["rough"], height_scan=True)
    worlds["ball_to_plane"] = EnvConfig(objects=(WorldObject("ball"),))
    configs = {"plane": EnvConfig(), **worlds}
    envs = {
        name: QuestVecEnv(clips(), config, args.envs, num_threads=args.threads)
        for name, config in configs.items()
    }
    act = springs(envs["plane"])
    observations = {name: env.reset() for name, env in envs.items()}
    ratios: dict[str, list[float]] = {name: [] for name in worlds}
    for step in range(args.steps + WARM_UP):
        seconds = {}
        for name, env in envs.items():
            action = act(observations[name])
            began = time.perf_counter()
            observations[name] = env.step(action)[0]
            seconds[name] = time.perf_counter() - began
        if step >= WARM_UP:  # the first steps warm caches and compile
            for name in worlds:
                ratios[name].append(seconds["plane"] / seconds[name])
    report({name: statistics.median(r) for name, r in ratios.items()}, args.json)


if __name__ == "__main__":
    main()
