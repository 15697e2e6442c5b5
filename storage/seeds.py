"""Independent random streams: every draw of a store is seeded by (seed, purpose, index)."""

import numpy as np

# From 100 on, so that no study's ground or body is one that the store was computed on.
SOBOL, BODY, TERRAIN, ROBUST_BODY, ROBUST_TERRAIN, WORLD, ROBUST_WORLD = range(100, 107)
TRIAL_SETTINGS, EVOLUTION = range(107, 109)


def seed_sequence(seed: int, purpose: int, index: int = 0) -> np.random.SeedSequence:
    """The stream of one draw."""
    return np.random.SeedSequence(entropy=seed, spawn_key=(purpose, index))
