"""A problem from outside as a study meets it: rows, the nearest row, the ranking, its maker."""

from pathlib import Path

import numpy as np
import optuna
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from study.benchmarks.outside import making
from study.benchmarks.outside.candidate_pool import column
from study.benchmarks.outside.definition import Definition, Feature, Settings
from study.benchmarks.outside.nearest import Nearest
from study.benchmarks.outside.outside_problem import OutsideProblem, outside_problem, read
from taichi_nmm.errors import InputError

SPACE = {
    "rate": FloatDistribution(1e-4, 1.0, log=True),
    "depth": IntDistribution(1, 9),
    "kind": CategoricalDistribution(("plain", "fancy")),
}
COLUMNS = {
    "rate": np.array([1e-4, 1e-2, 1.0, 1.0]),
    "depth": np.array([1, 5, 9, 9]),
    "kind": np.array(["plain", "fancy", "plain", "fancy"]),
}


def cheap(settings: Settings) -> tuple[float, ...]:
    deep = int(settings["depth"])
    return float("inf") if deep == 9 else deep, float("nan") if deep == 1 else -deep


def costly(settings: Settings) -> float:
    return float(settings["rate"]) + (settings["kind"] == "fancy")


MADE = Definition(
    name="made",
    purpose="tuning",
    field="testing",
    cost_meaning="a sum",
    space=SPACE,
    features={"depth": Feature("low", "itself"), "minus": Feature("high", "its opposite")},
    cheap=cheap,
    costly=costly,
)


@pytest.fixture
def made(tmp_path: Path) -> OutsideProblem:
    making.make(MADE, tmp_path / "made.parquet", lambda rows: rows, rows=64)
    return read(tmp_path / "made.parquet")


def nearest(**settings: float | int | str) -> int:
    return Nearest(SPACE, COLUMNS).row(settings)


def test_a_row_is_nearest_to_itself() -> None:
    for row in range(4):
        assert nearest(**{name: values[row].item() for name, values in COLUMNS.items()}) == row
    problem = outside_problem("digits-network")
    for row in range(0, len(problem), 50):
        assert problem.row_nearest_to(problem.settings(row)) == row


def test_distance_is_on_the_scale_of_the_parameter() -> None:
    """3e-3 is nearer to 1e-2 than to 1e-4 by its logarithm alone; integers count by their steps."""
    rates = Nearest({"rate": SPACE["rate"]}, {"rate": [1e-4, 1e-2, 1.0]})
    assert [rates.row({"rate": rate}) for rate in (5e-4, 3e-3, 0.05, 0.2)] == [0, 1, 1, 2]
    depths = Nearest({"depth": SPACE["depth"]}, {"depth": [1, 5, 9]})
    assert [depths.row({"depth": depth}) for depth in (2, 3, 4, 8)] == [0, 0, 1, 2]


def test_a_choice_is_kept_unless_all_else_would_change() -> None:
    # Another choice is sqrt 2 away, the ends of both numbers together as much.
    assert nearest(rate=1e-4, depth=5, kind="fancy") == 1
    assert nearest(rate=1.0, depth=9, kind="fancy") == 3
    assert nearest(rate=1.0, depth=9, kind="plain") == 2
    assert nearest(rate=1e-4, depth=2, kind="fancy") == 1


def test_the_objective_is_the_cost_of_the_nearest_row(made: OutsideProblem) -> None:
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=1))
    study.enqueue_trial(made.settings(7))
    study.optimize(made.objective, n_trials=5)
    assert study.trials[0].value == made.cost[7]
    for trial in study.trials:
        assert trial.value == made.cost[made.row_nearest_to(trial.params)]
        assert trial.distributions == made.space


def test_a_made_file_is_read_as_it_was_computed(made: OutsideProblem) -> None:
    assert len(made) == 64
    for row in range(64):
        settings = made.settings(row)
        assert type(settings["rate"]) is float
        assert type(settings["depth"]) is int
        assert type(settings["kind"]) is str
        np.testing.assert_array_equal(made.features[row], np.float32(cheap(settings)))
        assert made.cost[row] == np.float32(costly(settings))
    assert (made.field, made.cost_meaning, made.purpose) == ("testing", "a sum", "tuning")
    assert made.best == made.cost.min()


def test_the_ranking_is_the_mean_rank_from_the_good_ends(made: OutsideProblem) -> None:
    depth = made.columns["depth"]
    # Low depth is good, and so is a high opposite: they agree but where one of them failed.
    shallow, failed, deep = depth == 2, depth == 1, depth == 9
    assert made.ranking.shape == (64,)
    assert made.ranking[shallow].max() < made.ranking[deep].min()
    first = made.ranks[failed, 0]
    assert (first == first[0]).all() and first[0] == (failed.sum() + 1) / 2  # equal: their mean
    assert made.ranks[failed, 1].min() > made.ranks[~failed, 1].max()  # NaN: last
    np.testing.assert_allclose(made.ranking, made.ranks.mean(axis=1))


def test_a_column_is_uniform_on_its_scale() -> None:
    unit = (np.arange(1000) + 0.5) / 1000
    rate = column(SPACE["rate"], unit)
    assert rate.min() >= 1e-4 and rate.max() <= 1.0
    assert np.mean(rate < 1e-2) == pytest.approx(0.5, abs=0.01)
    np.testing.assert_array_equal(np.unique(column(SPACE["depth"], unit)), np.arange(1, 10))
    counts = np.unique(column(SPACE["kind"], unit), return_counts=True)[1]
    np.testing.assert_array_equal(counts, [500, 500])
    assert {f"{value:.4g}" for value in rate} == {f"{value:.9g}" for value in rate}


def test_a_file_that_is_none_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "broken.parquet").write_text("PAR1")
    for name in ("broken.parquet", "missing.parquet"):
        with pytest.raises(InputError, match=r"a file of tools/make_outside\.py"):
            read(tmp_path / name)
