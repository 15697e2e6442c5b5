"""Where on a network of roads is it loudest? Each measurement costs an afternoon.

Run it from the root of the registry: python package/samplers/pool/example.py
"""

from pathlib import Path

import numpy as np
import optuna
import optunahub
import scipy


REGISTRY = Path(__file__).parents[2]  # the folder `package`
SIDE = 25  # crossings on a side of the town


def main() -> optuna.Study:
    """Measure at thirty of 625 crossings."""
    street = scipy.sparse.diags_array([1.0, 1.0], offsets=[-1, 1], shape=(SIDE, SIDE))
    roads = scipy.sparse.kronsum(street, street)  # a crossing is joined to its neighbours
    x, y = np.divmod(np.arange(SIDE**2), SIDE)
    loudness = 70.0 * np.exp(-((x - 17) ** 2 + (y - 4) ** 2) / 60.0)  # unknown to the sampler
    loudness += 50.0 * np.exp(-((x - 5) ** 2 + (y - 20) ** 2) / 30.0)

    module = optunahub.load_local_module("samplers/pool", registry_root=str(REGISTRY))
    sampler = module.PoolSampler(graph=roads, seed=1)
    study = optuna.create_study(direction="maximize", sampler=sampler)
    study.optimize(lambda trial: loudness[trial.suggest_int("row", 0, SIDE**2 - 1)], n_trials=30)
    print(f"loudest {study.best_value:.1f} dB of {loudness.max():.1f}, {study.best_params}")
    return study


if __name__ == "__main__":
    main()
