"""Counts by hand; intervals and tests against closed forms and SciPy's."""

import numpy as np
import pytest
from scipy import stats

from study.report import numbers as counts
from study.report.numbers import curve, holm, median, numbers, wilcoxon, wilson
from tests.study.report.synthetic import arm, counted


def test_the_best_peer_has_most_walkers_then_the_earliest():
    few, late, early = (
        arm("tpe", [1, np.inf]),
        arm("random", [9, 9]),
        arm("cmaes-warm", [4, 4]),
    )
    ours = arm("worlds-stairs", [1, 1])
    assert counts.best_peer([few, late, early, ours]) == "cmaes-warm"
    ranked = counts.by_rank({each.arm: each for each in (few, late, early, ours)})
    assert ranked == ["worlds-stairs", "cmaes-warm", "random", "tpe"]
    assert counts.best_peer([ours]) is None
    assert (counts.kind_of("tpe"), counts.label_of("tpe")) == ("peer", "TPE")
    old = "score-first-old"
    assert (counts.kind_of(old), counts.label_of(old)) == ("ours", old)
    assert counts.best_peer([arm(old, [1])]) is None


def test_walkers_are_counted():
    found = numbers(counted(arm("dog", [1, 3, 11, 30, np.inf]))).arms[0]
    assert (found.walkers, found.runs, found.trials) == (4, 5, 40)
    assert found.share.value == 0.8
    assert found.first_walker.value == 11
    assert found.within == {1: 1, 3: 2, 10: 2, 30: 4}
    assert list(found.cost_after) == [10, 30]
    assert list(numbers(counted(arm("dog", [1], trials=10))).arms[0].cost_after) == [10]
    assert found.cost_after[30].value == pytest.approx(1.0 + 2 + 1.0 - 29 / 39)
    assert found.best_cost.value == pytest.approx(1.0 + 2)
    # all have walkers
    found = numbers(counted(arm("dog", [1, 2, 5], trials=8))).arms[0]
    assert found.within == {1: 1, 3: 2, 10: 3, 30: 3, 60: 3, 100: 3}
    assert 10 not in numbers(counted(arm("dog", [1, np.inf], trials=8))).arms[0].within


def test_arms_are_compared_with_ours_or_the_papers_on_the_same_runs():
    paper = arm("dog", [40] * 12, cost=2.0)
    better = arm("worlds-stairs", [1] * 10, cost=1.5)
    found = numbers(counted(paper, better)).comparisons
    assert [(each.arm, each.after) for each in found] == [
        ("worlds-stairs", n) for n in (10, 30)
    ]
    assert found[0].cost.pairs == found[1].cost.pairs == 10
    assert found[0].difference.value == pytest.approx(-0.5)
    # ties: all differ by as much
    assert found[0].cost.p == pytest.approx(2 / 2**10, rel=0.2)
    assert found[0].walkers.unequal == 0
    arms = [
        arm(name, [1] * 10, cost=1.5) for name in ("worlds-stairs", "tpe", "random")
    ]
    found = numbers(counted(arm("dog", [40] * 10, cost=2.0), *arms)).comparisons
    assert len(found) == 6
    for each in found:
        assert each.cost_p_holm == pytest.approx(3 * each.cost.p)
    plain = numbers(counted(arm("dog", [np.inf, np.inf]))).as_dict()
    assert plain["arms"][0]["first_walker"]["value"] is None
    assert plain["arms"][0]["within"]["30"] == 0


@pytest.mark.parametrize(("successes", "count"), [(0, 50), (1, 8), (37, 50), (50, 50)])
def test_wilson_has_the_closed_form(successes, count):
    """Its ends solve (p - share)^2 = z^2 p (1 - p) / n (Wilson, 1927)."""
    z, share = 1.959963984540054, successes / count
    found = wilson(successes, count)
    assert found.value == share
    assert 0.0 <= found.low <= share <= found.high <= 1.0 and found.low < found.high
    for p in (found.low, found.high):
        assert (p - share) ** 2 == pytest.approx(z * z * p * (1 - p) / count, abs=1e-12)


def test_runs_without_a_walker_are_later_than_all_others_and_equal_runs_are_certain():
    same = median(np.full(20, 3.0))
    assert (same.value, same.low, same.high) == (3.0, 3.0, 3.0)
    most = median([1.0, 2.0, 5.0, np.inf, np.inf, np.inf, np.inf])
    assert np.isinf(most.value) and np.isinf(most.high) and np.isfinite(most.low)
    few = median([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, np.inf])
    assert few.value == 4.0 and few.low <= 2.0
    none = median([np.inf] * 5)
    assert np.isinf(none.low)


def test_medians_interval_agrees_with_scipys_bootstrap_and_covers_the_truth():
    sample = np.random.default_rng(5).exponential(10.0, 50)
    how = {
        "method": "percentile",
        "n_resamples": 10_000,
        "rng": np.random.default_rng(0),
    }
    theirs = stats.bootstrap((sample,), np.median, **how).confidence_interval
    ours = median(sample)
    assert ours.value == np.median(sample)
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), rel=0.08)
    rng = np.random.default_rng(6)
    hits = 0
    for _ in range(80):
        found = median(rng.exponential(10.0, 50))
        hits += found.low <= 10.0 * np.log(2.0) <= found.high
    assert 0.88 <= hits / 80 <= 1.0


def test_curves_are_within_their_bands_and_the_same_twice():
    values = np.random.default_rng(7).normal(5.0, 1.0, (50, 12))
    middle, low, high = curve(values)
    np.testing.assert_allclose(middle, np.median(values, axis=0))
    assert np.all((low <= middle) & (middle <= high))
    assert np.all(high - low < 1.2)
    np.testing.assert_array_equal(counts.resamples(7, 5), counts.resamples(7, 5))
    assert counts.resamples(7, 5).max() < 7
    assert not np.array_equal(counts.resamples(7, 5)[:, :6], counts.resamples(6, 5))


def test_wilcoxon_of_all_better_has_the_closed_form():
    """Eight pairs of one sign: two of 2^8 assignments are as extreme."""
    found = wilcoxon(np.arange(8.0), np.arange(8.0) + np.linspace(1, 2, 8))
    assert (found.pairs, found.unequal) == (8, 8)
    assert found.p == pytest.approx(2 / 2**8)
    same = wilcoxon([1.0, 2.0], [1.0, 2.0])
    assert (same.pairs, same.unequal, same.p) == (2, 0, 1.0)
    some = wilcoxon([1.0, 2.0, 3.0, 4.0], [1.0, 2.1, 3.2, 4.4])
    assert (some.pairs, some.unequal) == (4, 3)
    assert some.p == pytest.approx(2 / 2**3)


def test_mcnemar_rests_on_runs_of_one_arm_and_holm_is_the_textbooks():
    ours = np.array([True] * 40 + [False] * 10)
    theirs = np.array([True] * 34 + [False] * 15 + [True])
    found = counts.mcnemar(ours, theirs)
    assert (found.pairs, found.unequal) == (50, 7)
    assert found.p == pytest.approx(2 * (1 + 7) / 2**7)
    assert counts.mcnemar(ours, ours).p == 1.0
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([]) == []
