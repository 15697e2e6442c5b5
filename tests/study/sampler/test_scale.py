"""Features on the scales of the model, against SciPy, and what no monotone change of one alters."""

from collections.abc import Callable
from typing import Any

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.stats import norm, rankdata

from study import FeatureKernelSampler, FeatureTable
from study.sampler.transforms import LEAST_GAPS, NormalScores, Standard

Floats = NDArray[np.float64]
NAN, INF = np.nan, np.inf


def blom(rows: Floats, values: Floats) -> Floats:
    """Normal scores of values among rows, by SciPy: of each alone, put in among the rows."""
    known = rows[~np.isnan(rows)]
    ranks = []
    for value in values:
        with_it = rankdata(np.append(known, value))  # it is itself among those that are equal
        among = with_it[-1] if value in known else with_it[-1] - 0.5
        ranks.append(among - 0.5 * (value in known))
    clipped = np.clip(ranks, 1, len(known))
    own = norm.ppf((rankdata(known) - 0.375) / (len(known) + 0.25))
    scores = norm.ppf((clipped - 0.375) / (len(known) + 0.25)) / own.std()
    return np.where(np.isnan(values), 0.0, scores)


def drawn(seed: int) -> Floats:
    """A column with ties, infinities of both signs, gaps, and a heavy tail, [60]."""
    rng = np.random.default_rng(seed)
    values = np.round(rng.standard_cauchy(60), 1)
    values[rng.choice(60, 12, replace=False)] = np.repeat([INF, -INF, NAN], 4)
    return np.asarray(values)


@pytest.mark.parametrize("seed", range(20))
def test_normal_scores_are_scipys(seed: int) -> None:
    rows = drawn(seed)
    scores = NormalScores.of(rows[:, None])
    others = np.concatenate([drawn(seed + 100), rows, [-1e9, 1e9]])  # on the rows, between, beyond
    assert_allclose(scores.standard(others[:, None])[:, 0], blom(rows, others), atol=1e-12)
    own = scores.standard(rows[:, None])[:, 0]
    assert_allclose(own[~np.isnan(rows)].std(), 1.0)


def test_columns_are_scored_one_by_one() -> None:
    features = np.column_stack([drawn(seed) for seed in range(3)])
    together = NormalScores.of(features).standard(features)
    for column in range(3):
        alone = features[:, [column]]
        assert_array_equal(together[:, column], NormalScores.of(alone).standard(alone)[:, 0])


@pytest.mark.parametrize("value", [7.0, INF, -INF])
def test_a_constant_is_zero_wherever_it_is_asked(value: float) -> None:
    rows = np.array([[value], [value], [NAN]])
    standard = NormalScores.of(rows).standard(np.array([[value], [1e9], [-1e9], [NAN]]))
    assert not standard[:, 0].any()
    assert_allclose(standard[:, 1], [-np.sqrt(0.5)] * 3 + [np.sqrt(2.0)])  # a third has a gap


def test_without_rows_all_are_alike() -> None:
    assert_array_equal(NormalScores.of(np.empty((0, 2))).standard(np.array([[1.0, NAN]])), [[0, 0]])


def test_a_feature_with_gaps_has_a_column_that_says_so_each_pattern_once() -> None:
    rows = np.random.default_rng(0).normal(size=(100, 4))
    rows[:30, 1] = rows[:30, 2] = NAN  # one pattern
    rows[90:, 3] = NAN
    standard = NormalScores.of(rows).standard(rows)
    assert standard.shape == (100, 6)
    for column, feature in ((4, 1), (5, 3)):
        missing = np.isnan(rows[:, feature]).astype(float)
        assert_allclose(standard[:, column], (missing - missing.mean()) / missing.std())
    assert not standard[:30, 1].any() and not standard[90:, 3].any()


@pytest.mark.parametrize(("missing", "columns"), [(0, 1), (2, 1), (3, 2), (97, 2), (98, 1)])
def test_hardly_any_gaps_or_hardly_any_values_are_no_column(missing: int, columns: int) -> None:
    rows = np.arange(100.0)[:, None]
    rows[:missing] = NAN
    assert LEAST_GAPS == 0.02
    assert NormalScores.of(rows).standard(rows).shape == (100, columns)


def test_the_affine_scale_is_numpys_and_takes_infinities_for_gaps() -> None:
    rows = np.column_stack([drawn(3), np.full(60, 5.0)])
    known = rows[np.isfinite(rows[:, 0]), 0]
    expected = np.where(np.isfinite(rows[:, 0]), (rows[:, 0] - known.mean()) / known.std(), 0.0)
    assert_allclose(
        Standard.of(rows).standard(rows), np.column_stack([expected, np.zeros(60)]), atol=1e-12
    )


A, B = np.random.default_rng(4).uniform(size=(2, 50))
FEATURES = np.column_stack([np.abs(A - 0.4), B, A + B])


def proposed(features: Floats, **options: Any) -> list[int]:
    """Rows of 14 trials of a study over a table with these features."""
    table = FeatureTable.from_arrays({"a": A, "b": B}, features)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=2, **options))
    study.optimize(
        lambda t: (t.suggest_float("a", 0, 1) - 0.4) ** 2 + 0.1 * t.suggest_float("b", 0, 1),
        n_trials=14,
    )
    return [trial.user_attrs["row"] for trial in study.trials]


def to_infinity(column: Floats) -> Floats:
    """The largest and the smallest value made infinite."""
    ends = np.where(column == column.max(), INF, np.where(column == column.min(), -INF, column))
    return np.asarray(ends)


CHANGES: dict[str, Callable[[Floats], Floats]] = {
    "cubed and moved": lambda column: 1e3 * (column - 0.3) ** 3 - 50.0,
    "heavy-tailed, to 1e6": lambda column: np.expm1((column / column.max()) ** 9 * np.log(1e6)),
    "ranks": rankdata,
    "with infinities": to_infinity,
}


@pytest.mark.parametrize("options", [{}, {"prior": "-feature_0"}])
@pytest.mark.parametrize("columns", [[0], [1], [2], [0, 1, 2]])
@pytest.mark.parametrize("change", CHANGES)
def test_an_increasing_change_of_a_feature_changes_no_proposal(
    change: str, columns: list[int], options: dict[str, Any]
) -> None:
    changed = FEATURES.copy()
    for column in columns:
        changed[:, column] = CHANGES[change](FEATURES[:, column])
        order = np.argsort(FEATURES[:, column])
        assert np.all(np.diff(changed[order, column]) > 0)  # or it is no test
    assert proposed(changed, **options) == proposed(FEATURES, **options)
