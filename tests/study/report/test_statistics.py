"""Intervals and tests against closed forms, other implementations, and their own coverage."""

import numpy as np
import pytest
from scipy import stats

from study.report.numbers import (
    curve,
    holm,
    mcnemar,
    median,
    resamples,
    wilcoxon,
    wilson,
)


@pytest.mark.parametrize(("successes", "count"), [(0, 50), (1, 8), (37, 50), (50, 50)])
def test_wilson_is_scipys(successes: int, count: int) -> None:
    theirs = stats.binomtest(successes, count).proportion_ci(method="wilson")
    ours = wilson(successes, count)
    assert ours.value == successes / count
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    assert 0.0 <= ours.low <= ours.value <= ours.high <= 1.0


def test_wilson_at_its_ends_has_the_closed_form() -> None:
    """Of n of n, the lower end is n / (n + z^2): 95 % of runs are not claimed from a few."""
    z = 1.959963984540054
    assert wilson(50, 50).low == pytest.approx(50 / (50 + z * z))
    assert wilson(0, 50).high == pytest.approx(z * z / (50 + z * z))


def test_wilson_of_no_runs_says_nothing() -> None:
    found = wilson(0, 0)
    assert np.isnan(found.value)
    assert (found.low, found.high) == (0.0, 1.0)


def test_median_of_equal_runs_is_certain() -> None:
    found = median(np.full(20, 3.0))
    assert (found.value, found.low, found.high) == (3.0, 3.0, 3.0)


def test_runs_without_a_walker_are_later_than_all_others() -> None:
    most = median([1.0, 2.0, 5.0, np.inf, np.inf, np.inf, np.inf])
    assert np.isinf(most.value) and np.isinf(most.high) and np.isfinite(most.low)
    few = median([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, np.inf])
    assert few.value == 4.0 and few.low <= 2.0
    none = median([np.inf] * 5)
    assert np.isinf(none.low)


def test_medians_interval_agrees_with_scipys_bootstrap() -> None:
    sample = np.random.default_rng(5).exponential(10.0, 50)
    theirs = stats.bootstrap(
        (sample,), np.median, method="percentile", n_resamples=10_000, rng=np.random.default_rng(0)
    ).confidence_interval
    ours = median(sample)
    assert ours.value == np.median(sample)
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), rel=0.08)


def test_medians_interval_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(6)
    hits = 0
    for _ in range(80):
        found = median(rng.exponential(10.0, 50))
        hits += found.low <= 10.0 * np.log(2.0) <= found.high
    assert 0.88 <= hits / 80 <= 1.0


def test_curves_are_means_and_medians_within_their_bands() -> None:
    values = np.random.default_rng(7).normal(5.0, 1.0, (50, 12))
    for statistic in (np.mean, np.median):
        middle, low, high = curve(values, statistic)
        np.testing.assert_allclose(middle, statistic(values, axis=0))
        assert np.all((low <= middle) & (middle <= high))
        assert np.all(high - low < 1.2)
    _, low, high = curve(values, np.mean)
    normal = 2 * 1.96 * values.std(axis=0) / np.sqrt(50)
    np.testing.assert_allclose(high - low, normal, rtol=0.1)


def test_a_report_made_twice_is_the_same() -> None:
    np.testing.assert_array_equal(resamples(7, 5), resamples(7, 5))
    assert resamples(7, 5).max() < 7
    assert not np.array_equal(resamples(7, 5)[:, :6], resamples(6, 5))


def test_wilcoxon_is_scipys_and_counts_its_pairs() -> None:
    rng = np.random.default_rng(8)
    ours, theirs = rng.normal(0.0, 1.0, 40), rng.normal(0.4, 1.0, 40)
    found = wilcoxon(ours, theirs)
    assert found.p == pytest.approx(stats.wilcoxon(ours, theirs).pvalue)
    assert (found.pairs, found.unequal) == (40, 40)


def test_wilcoxon_of_all_better_has_the_closed_form() -> None:
    """Eight pairs of one sign: two of 2^8 assignments are as extreme."""
    found = wilcoxon(np.arange(8.0), np.arange(8.0) + np.linspace(1, 2, 8))
    assert found.p == pytest.approx(2 / 2**8)


def test_equal_pairs_decide_nothing() -> None:
    same = wilcoxon([1.0, 2.0], [1.0, 2.0])
    assert (same.pairs, same.unequal, same.p) == (2, 0, 1.0)
    some = wilcoxon([1.0, 2.0, 3.0, 4.0], [1.0, 2.1, 3.2, 4.4])
    assert (some.pairs, some.unequal) == (4, 3)
    assert some.p == pytest.approx(2 / 2**3)


def test_mcnemar_rests_on_runs_of_which_one_arm_alone_walked() -> None:
    ours = np.array([True] * 40 + [False] * 10)
    theirs = np.array([True] * 34 + [False] * 16)
    found = mcnemar(ours, theirs)
    assert (found.pairs, found.unequal) == (50, 6)
    assert found.p == pytest.approx(2 / 2**6)
    assert mcnemar(ours, ours).p == 1.0


def test_holm_is_the_textbooks() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([]) == []
