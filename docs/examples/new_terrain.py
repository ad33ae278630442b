"""A new kind of ground: ridges across the way, a metre apart."""

import numpy as np

from envs import BatchSim, EnvConfig, Terrain, terrain_named
from envs.terrain import register_terrain
from questsim.motion.synthesis.synthetic import synthesise


def ridges(terrain: Terrain, x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Triangular ridges along y, as high as the terrain's amplitude, of uneven strength."""
    number = np.floor(x).astype(int)
    strength = rng.uniform(0.5, 1.0, np.ptp(number) + 1)[number - number.min()]
    distance = np.abs(np.mod(x, 1.0) - 0.5)
    return terrain.amplitude_m * strength * np.clip(1.0 - distance / 0.2, 0.0, 1.0)


register_terrain("ridges", ridges, amplitude_m=0.05, direction="up")


def main() -> BatchSim:
    """Walk over ridges without any torque, which does not end well."""
    terrain = terrain_named("ridges:amplitude_m=0.06")
    sim = BatchSim([synthesise("walk", duration=2.0)], EnvConfig(terrain=terrain), num_envs=2)
    sim.reset()
    for _ in range(10):
        sim.step(np.zeros((2, 33)))
    return sim


if __name__ == "__main__":
    print("height of the ground under each avatar:", main().floor)
