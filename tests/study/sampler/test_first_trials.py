"""The trials before there is a model."""

from typing import Any

import numpy as np
import optuna
import pytest
from numpy.typing import NDArray
from optuna.distributions import FloatDistribution

from study import FeatureKernelSampler, FeatureTable
from study.sampler.gp import KERNELS

Floats = NDArray[np.float64]
ROWS = 70
SPACE = {"x": FloatDistribution(0, 1)}


def drawn(seed: int) -> Floats:
    """Three features with a common part, heavy-tailed, of different units, [70, 3]."""
    rng = np.random.default_rng(seed)
    common = rng.standard_normal(ROWS)
    own = rng.standard_normal((ROWS, 3))
    return np.exp(0.8 * common[:, None] + 0.4 * own) * [1.0, 1e3, 1e-3]


def first_rows(features: Floats, trials: int, *, seed: int = 0, **options: Any) -> list[int]:
    """Rows of the first trials, whose costs have nothing to do with them."""
    table = FeatureTable.from_arrays({"x": np.linspace(0, 1, ROWS)}, features)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=seed, **options))
    costs = np.random.default_rng(seed).uniform(size=ROWS)
    study.optimize(lambda trial: costs[trial.number] + 0 * trial.suggest_float("x", 0, 1), trials)
    return [trial.user_attrs["row"] for trial in study.trials]


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("sign", ["", "-"])
@pytest.mark.parametrize("column", range(3))
def test_with_a_prior_they_are_the_first_three_of_the_ranking(
    kernel: str, sign: str, column: int
) -> None:
    for seed in range(3):
        features = drawn(seed)
        best_first = np.argsort(features[:, column] if sign else -features[:, column])
        rows = first_rows(features, 3, seed=seed, kernel=kernel, prior=f"{sign}feature_{column}")
        assert rows == best_first[:3].tolist()


def test_an_infinite_score_is_the_best_or_the_worst() -> None:
    features = drawn(0)
    features[[5, 6], 0] = np.inf, -np.inf
    assert first_rows(features, 1, prior="feature_0") == [5]
    assert first_rows(features, 1, prior="-feature_0") == [6]


@pytest.mark.parametrize("seed", range(5))
def test_without_one_they_are_the_ends_of_the_first_principal_component(seed: int) -> None:
    features = drawn(seed)
    scores = FeatureTable.from_arrays(
        {"x": np.linspace(0, 1, ROWS)}, features
    ).rows.scores.standard(features)
    centred = scores - scores.mean(axis=0)
    along = np.linalg.svd(centred)[0][:, 0]  # not by eigenvalues, as the sampler does
    ends = {int(np.argmin(along)), int(np.argmax(along))}
    rows = first_rows(features, 2, seed=seed)
    assert set(rows) == ends
    assert scores[rows[0]].sum() > scores[rows[1]].sum()  # more of most features first


def test_one_feature_alone_is_tried_at_its_ends() -> None:
    feature = drawn(1)[:, 0]
    assert first_rows(feature, 2) == [int(np.argmax(feature)), int(np.argmin(feature))]


def test_other_kernels_begin_at_random() -> None:
    for kernel in ("rbf", "rbf_ard", "euclidean"):
        first = {tuple(first_rows(drawn(0), 3, seed=seed, kernel=kernel)) for seed in range(6)}
        assert len(first) == 6


def test_trials_that_can_be_learned_from_count_among_them() -> None:
    """Two finished rows, enqueued: the third trial is the model's, or still the ranking's."""
    features = drawn(2)
    for options, expected in (({}, None), ({"prior": "feature_0"}, int(features[:, 0].argmax()))):
        table = FeatureTable.from_arrays({"x": np.linspace(0, 1, ROWS)}, features)
        study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=0, **options))
        middle = np.argsort(features[:, 0])[[30, 40]]
        for row in middle:
            study.enqueue_trial(table.rows.as_parameters(int(row)))
        study.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=3)
        constants = study.sampler._policy.known  # type: ignore[attr-defined]
        assert bool(constants) is (expected is None)
        assert expected is None or study.trials[2].user_attrs["row"] == expected


def ends_first(params: Floats) -> Floats:
    return np.column_stack([np.exp(9.0 * params[:, 0]), params[:, 0] ** 3])


@pytest.mark.parametrize(
    ("prior", "low", "high"), [(None, [0.99, 0.0], [1.0, 0.01]), ("-feature_1", [0.0], [0.01])]
)
def test_of_a_space_they_are_the_ends_too(
    prior: str | None, low: list[float], high: list[float]
) -> None:
    """Of 2,048 points anywhere, the last lies within a hundredth of an end: 1 - 1e-9 are sure."""
    sampler = FeatureKernelSampler(ends_first, seed=3, prior=prior, space=SPACE)
    study = optuna.create_study(sampler=sampler)
    study.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=len(low))
    for trial, least, most in zip(study.trials, low, high, strict=True):
        assert least <= trial.params["x"] <= most
