"""A catapult whose simulator is wrong: no air, and a spring that is too weak.

Run it from the root of the registry: python package/samplers/feature_kernel/example.py
"""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray
import optuna
import optunahub


TARGET_M = 20.0
GRAVITY_MPS2 = 9.81
REGISTRY = Path(__file__).parents[2]  # the folder `package`


def throw(
    pull_m: ArrayLike,
    angle_deg: ArrayLike,
    stiffness_npm: float = 600.0,
    drag_per_m: float = 0.0,
) -> NDArray[np.float64]:
    """Where a ball of 0.5 kg lands, in metres: of one throw, or of a column of throws at once."""
    speed = np.asarray(pull_m, dtype=np.float64) * np.sqrt(stiffness_npm / 0.5)
    vx, vz = speed * np.cos(np.radians(angle_deg)), speed * np.sin(np.radians(angle_deg))
    x: NDArray[np.float64] = np.zeros_like(speed)
    height = np.ones_like(speed)
    dt_s = 0.01
    for _ in range(1500):
        flying, drag = height > 0, drag_per_m * np.hypot(vx, vz)
        x, height = x + flying * vx * dt_s, height + flying * vz * dt_s
        vx, vz = vx - vx * drag * dt_s, vz - (GRAVITY_MPS2 + vz * drag) * dt_s
    return x


def objective(trial: optuna.Trial) -> float:
    """One costly throw of the real catapult: how far from the target."""
    pull = trial.suggest_float("pull_m", 0.1, 1.0)
    angle = trial.suggest_float("angle_deg", 10.0, 80.0)
    return float(abs(throw(pull, angle, stiffness_npm=700.0, drag_per_m=0.02) - TARGET_M))


def main() -> optuna.Study:
    """Throw thirty times."""
    module = optunahub.load_local_module("samplers/feature_kernel", registry_root=str(REGISTRY))
    rng = np.random.default_rng(0)
    pull, angle = rng.uniform(0.1, 1.0, 2000), rng.uniform(10.0, 80.0, 2000)
    landing = throw(pull, angle)  # of the wrong simulator
    features = np.column_stack([landing, abs(landing - TARGET_M)])
    table = module.FeatureTable.from_arrays({"pull_m": pull, "angle_deg": angle}, features)
    study = optuna.create_study(sampler=module.FeatureKernelSampler(table, seed=1))
    study.optimize(objective, n_trials=30)
    print(f"best miss {study.best_value:.2f} m with {study.best_params}")
    return study


if __name__ == "__main__":
    main()
