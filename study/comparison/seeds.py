"""The seed of a sampler: it depends on the experiment, the arm and the run, and on nothing else."""

import numpy as np

from study.draws import name_key

SAMPLER = 12  # goes on from `study.draws.Purpose`


def sampler_seed(experiment_seed: int, arm: str, run: int) -> int:
    """The seed of one study's sampler, 64 bits."""
    sequence = np.random.SeedSequence(experiment_seed, spawn_key=(SAMPLER, name_key(arm), run))
    return int(sequence.generate_state(1, np.uint64)[0])
