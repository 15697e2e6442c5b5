"""Costs and features on the scales of the model, against SciPy; tables larger than memory."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm, rankdata

from study import FeatureTable
from study.sampler import transforms
from study.sampler.transforms import LARGEST, NormalScores, Standard, log_excess
from tests.cases import cases
from tests.study.sampler import studies

NAN, INF = np.nan, np.inf
CLIFF = np.array([-1.0, 0.0, 2.0, 1e6, 2.0])


def test_the_cost_is_the_logarithm_of_the_excess_in_typical_units():
    expected = np.log1p((CLIFF + 1.0) / 3.0)  # 3: the median of 1, 3, 3, 1e6
    assert_allclose(log_excess(CLIFF, CLIFF), expected)
    # Whatever its unit.
    assert_allclose(log_excess(1e3 * CLIFF - 7.0, 1e3 * CLIFF - 7.0), expected)
    assert_allclose(log_excess(np.full(4, 3.0), np.full(4, 3.0)), 0.0)


def test_the_order_of_large_costs_is_kept():
    cost = np.array([-1e307, 4e307, 3e307, 1.0, LARGEST, -LARGEST])
    found = log_excess(cost, cost)
    assert np.isfinite(found).all()
    assert np.argsort(found).tolist() == np.argsort(cost).tolist()


@cases("stand-ins.toml", "given", "known", "ends")
def test_infinity_is_beyond_all_numbers(given, known, ends):
    assert transforms.stand_ins(np.array(given), np.array(known)) == pytest.approx(ends)


@cases("limits-by-side.toml", "told", "expected")
def test_a_limit_keeps_its_side_whatever_stands_for_infinity(told, expected):
    assert_allclose(transforms.by_side(np.array(told)), expected)


@pytest.mark.parametrize("factor", [1e-300, 5e-324, 1e-13, 1e12, 1e300])
def test_a_limit_keeps_its_side_in_any_unit(factor):
    told = factor * np.array([3.0, -1.0, 2.0, -INF, INF, -2.0])
    found = transforms.by_side(told)
    assert ((found > 0.0) == (told > 0.0)).all()
    assert 1.0 <= np.abs(found).max() < 4.0 and np.isfinite(found).all()


# Scales of features.
def blom(rows, values):
    """Normal scores of values among rows, by SciPy: of each alone, put in among the rows."""
    known = rows[~np.isnan(rows)]
    ranks = []
    for value in values:
        # It is itself among those that are equal.
        with_it = rankdata(np.append(known, value))
        among = with_it[-1] if value in known else with_it[-1] - 0.5
        ranks.append(among - 0.5 * (value in known))
    clipped = np.clip(ranks, 1, len(known))
    own = norm.ppf((rankdata(known) - 0.375) / (len(known) + 0.25))
    scores = norm.ppf((clipped - 0.375) / (len(known) + 0.25)) / own.std()
    return np.where(np.isnan(values), 0.0, scores)


def drawn(seed):
    """A column with ties, infinities of both signs, gaps, and a heavy tail, [60]."""
    rng = np.random.default_rng(seed)
    values = np.round(rng.standard_cauchy(60), 1)
    values[rng.choice(60, 12, replace=False)] = np.repeat([INF, -INF, NAN], 4)
    return np.asarray(values)


@pytest.mark.parametrize("seed", range(20))
def test_normal_scores_are_scipys_of_each_column_alone(seed):
    rows, others = (
        np.column_stack([drawn(n), drawn(n + 50)]) for n in (seed, seed + 100)
    )
    # On, between, beyond them.
    others = np.concatenate([others, rows, [[-1e9, 1e9], [1e9, -1e9]]])
    scores = NormalScores.of(rows)
    found, own = scores.standard(others), scores.own
    assert np.array_equal(own, scores.standard(rows))  # to the bit
    for column in range(2):
        assert_allclose(
            found[:, column], blom(rows[:, column], others[:, column]), atol=1e-12
        )
        assert_allclose(own[~np.isnan(rows[:, column]), column].std(), 1.0)


@pytest.mark.parametrize("value", [7.0, INF, -INF])
def test_a_constant_is_zero_wherever_it_is_asked_and_without_rows_all_are(value):
    rows = np.array([[value], [value], [NAN]])
    standard = NormalScores.of(rows).standard(np.array([[value], [1e9], [-1e9], [NAN]]))
    assert not standard[:, 0].any()
    # A third has a gap.
    assert_allclose(standard[:, 1], [-np.sqrt(0.5)] * 3 + [np.sqrt(2.0)])
    assert (
        not NormalScores.of(np.empty((0, 2))).standard(np.array([[value, NAN]])).any()
    )


def test_a_feature_with_gaps_has_a_column_that_says_so_each_pattern_once():
    rows = np.random.default_rng(0).normal(size=(100, 4))
    rows[:30, 1] = rows[:30, 2] = NAN  # one pattern
    rows[90:, 3] = NAN
    scale = NormalScores.of(rows)
    standard = scale.standard(rows)
    assert standard.shape == (100, 6)
    for column, feature in ((4, 1), (5, 3)):
        missing = np.isnan(rows[:, feature]).astype(float)
        assert_allclose(standard[:, column], (missing - missing.mean()) / missing.std())
    assert not standard[:30, 1].any() and not standard[90:, 3].any()


@pytest.mark.parametrize(
    ("missing", "columns"), [(0, 1), (2, 1), (3, 2), (97, 2), (98, 1)]
)
def test_hardly_any_gaps_or_hardly_any_values_are_no_column(missing, columns):
    rows = np.arange(100.0)[:, None]
    rows[:missing] = NAN
    assert transforms.LEAST_GAPS == 0.02
    assert NormalScores.of(rows).standard(rows).shape == (100, columns)


def test_the_affine_scale_is_numpys_and_infinity_is_beyond_all_values():
    rows = np.column_stack([drawn(3), np.full(60, 5.0)])
    column = rows[:, 0].copy()
    finite = column[np.isfinite(column)]
    reach = finite.max() - finite.min()
    column[column == INF] = finite.max() + reach
    column[column == -INF] = finite.min() - reach
    known = column[~np.isnan(column)]
    expected = np.where(np.isnan(column), 0.0, (column - known.mean()) / known.std())
    scale = Standard.of(rows)
    found = scale.standard(rows)
    assert_allclose(found, np.column_stack([expected, np.zeros(60)]), atol=1e-12)
    assert np.argsort(
        scale.standard(np.array([[INF, 5.0], [-INF, 5.0]]))[:, 0]
    ).tolist() == [1, 0]


A, B = np.random.default_rng(4).uniform(size=(2, 50))
FEATURES = np.column_stack([np.abs(A - 0.4), B, A + B])


def proposed(features):
    """Rows of 14 trials of a study over a table with these features."""
    table = FeatureTable.from_arrays({"a": A, "b": B}, features)

    def cost(t):
        return (t.suggest_float("a", 0, 1) - 0.4) ** 2 + 0.1 * t.suggest_float(
            "b", 0, 1
        )

    return studies.rows_of(studies.study_of(table, cost, 14, seed=2))


CHANGES = {
    "cubed and moved": lambda column: 1e3 * (column - 0.3) ** 3 - 50.0,
    "heavy-tailed, to 1e6": lambda column: np.expm1(
        (column / column.max()) ** 9 * np.log(1e6)
    ),
    "ranks": rankdata,
    "with infinities": lambda column: np.where(
        column == column.max(), INF, np.where(column == column.min(), -INF, column)
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_an_increasing_change_of_all_features_changes_no_proposal(change):
    changed = np.apply_along_axis(CHANGES[change], 0, FEATURES)
    for before, after in zip(FEATURES.T, changed.T, strict=True):
        assert np.all(np.diff(after[np.argsort(before)]) > 0)  # or it is no test
    assert proposed(changed) == proposed(FEATURES)


@pytest.mark.parametrize("seed", range(4))
def test_two_groups_differ_as_much_as_any_two(seed):
    """Against the variance within both groups, for each way to part them."""
    rng = np.random.default_rng(seed)
    values = np.concatenate([rng.normal(size=20), 4.0 + 0.5 * rng.normal(size=9)])
    ordered = np.sort(values)
    within = [
        ordered[:n].var() * n + ordered[n:].var() * (29 - n) for n in range(1, 29)
    ]
    best = int(np.argmin(within))
    middle, apart = transforms.two_groups(values)
    assert middle == pytest.approx(ordered[best : best + 2].mean())
    assert apart == pytest.approx(1.0 - within[best] / (29 * values.var()))


def test_how_far_known_spreads_fall_apart():
    assert transforms.two_groups(np.array([3.0, 3.0, 5.0])) == (4.0, pytest.approx(1.0))
    assert transforms.two_groups(np.full(7, 0.1)) == (0.1, 0.0)  # whose mean is another
    evenly = np.linspace(0.0, 1.0, 2001)
    assert transforms.two_groups(evenly)[1] == pytest.approx(0.75, abs=0.001)
    normal = norm.ppf((np.arange(2000) + 0.5) / 2000)
    assert transforms.two_groups(normal)[1] == pytest.approx(2.0 / np.pi, abs=0.005)
