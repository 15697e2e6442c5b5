"""Features that reality shows otherwise: what is learned, where, and what it is worth."""

import numpy as np
import optuna
from numpy.testing import assert_allclose

from study import FeatureKernelSampler, FeatureTable
from study.sampler.mismatch import Mismatch, read_shown
from study.sampler.points import Points


def points(count: int, seed: int) -> Points:
    rng = np.random.default_rng(seed)
    return Points(rng.standard_normal((count, 2)), rng.uniform(0.0, 0.5, (count, 3)))


def test_candidates_near_reports_are_corrected_and_far_ones_are_not() -> None:
    seen = points(25, seed=0)
    shown = seen.features - np.array([1.5, -0.5])  # simulated too high, and too low
    shown[0] = np.nan  # one trial says nothing
    mismatch = Mismatch.fit(seen, shown, parameters=3, fast=False)
    assert mismatch is not None
    near = Points(np.zeros((1, 2)), np.full((1, 3), 0.25))
    assert_allclose(mismatch.corrected(near).features, [[-1.5, 0.5]], atol=0.15)
    far = Points(np.zeros((1, 2)), np.full((1, 3), 1e3))
    assert_allclose(mismatch.corrected(far).features, 0.0, atol=1e-6)


def test_nothing_reported_is_nothing_learned() -> None:
    seen = points(3, seed=0)
    assert Mismatch.fit(seen, np.full((3, 2), np.nan), parameters=3, fast=True) is None


def test_reports_are_lists_or_for_one_feature_a_number() -> None:
    reports = [[1.0, 2.0], None, [1.0], "no", [3, float("nan")], {"a": 1}]
    trials = [
        optuna.create_trial(value=0.0, user_attrs={} if r is None else {"shown": r})
        for r in reports
    ]
    shown = read_shown(trials, "shown", 2)
    assert shown[0].tolist() == [1.0, 2.0]
    assert np.isnan(shown[[1, 2, 3, 5]]).all()
    single = optuna.create_trial(value=0.0, user_attrs={"shown": 4})
    assert read_shown([single], "shown", 1).tolist() == [[4.0]]


def test_a_sampler_that_is_told_finds_better_rows() -> None:
    """Half of the rows look good in simulation and are not."""
    rng = np.random.default_rng(1)
    a, side = rng.uniform(size=400), rng.uniform(size=400)
    real = np.abs(a - 0.3)
    simulated = np.where(side > 0.5, 0.3 * rng.uniform(size=400), real)
    table = FeatureTable.from_arrays({"a": a, "side": side}, simulated)

    def objective(trial: optuna.Trial) -> float:
        trial.suggest_float("side", 0, 1)
        cost = abs(trial.suggest_float("a", 0, 1) - 0.3)
        trial.set_user_attr("shown", [cost])
        return cost

    def mean_of_late_trials(mismatch: str | None) -> float:
        values = []
        for seed in range(2):
            sampler = FeatureKernelSampler(table, seed=seed, mismatch=mismatch)
            study = optuna.create_study(sampler=sampler)
            study.optimize(objective, n_trials=16)
            values += [trial.value for trial in study.trials[8:]]
        return float(np.mean(values))

    assert mean_of_late_trials("shown") < 0.8 * mean_of_late_trials(None)
