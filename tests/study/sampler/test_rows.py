"""Rows that a number stands for: decimal grids, printed numbers, ends of ranges, whole numbers."""

from decimal import Decimal

import numpy as np
import optuna
import pytest
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from study import FeatureKernelSampler, FeatureTable
from tests.study.conftest import refused
from tests.study.sampler.studies import rows_of, study_of, summed, without_warning


def rows_like(columns, **options):
    """A table of these columns; features are their numbers."""
    count = len(next(iter(columns.values())))
    return FeatureTable.from_arrays(columns, np.arange(float(count)), **options).rows


# Decimal grids.
TENTHS = np.arange(0.0, 1.01, 0.1)
X, Y = (side.ravel() for side in np.meshgrid(TENTHS, TENTHS))
GRID = {"x": X, "y": Y}


@pytest.mark.parametrize(
    ("start", "end", "step"),
    [
        (0.0, 1.0, 0.1),
        (-1.0, 1.0, 0.1),
        (-100.0, 100.0, 0.1),
        (-10.0, 10.0, 0.01),
        (0.05, 0.5, 0.05),
    ],
)
def test_every_decimal_of_a_grid_is_its_row(start, end, step):
    column = np.arange(start, end + 0.5 * step, step)
    rows = rows_like({"x": column})
    decimals = [round(start + number * step, 10) for number in range(len(column))]
    # Else there is nothing to see.
    assert sum(decimal not in column for decimal in decimals) > 1
    assert [rows.find({"x": decimal}) for decimal in decimals] == list(
        range(len(column))
    )
    between = [decimal + 1e-3 * step for decimal in decimals]
    assert {rows.find({"x": value}) for value in between} == {None}


def test_an_enqueued_decimal_is_learned_from_and_not_proposed_again():
    table = FeatureTable.from_arrays(GRID, np.column_stack([X, Y]))
    wanted = {"x": 0.3, "y": 0.7}
    assert not any((X == 0.3) & (Y == 0.7))

    def objective(trial):
        x, y = trial.suggest_float("x", 0, 1), trial.suggest_float("y", 0, 1)
        return (x - 0.3) ** 2 + (y - 0.7) ** 2

    study = study_of(table, enqueued=[wanted])
    without_warning(study, objective, 30)
    rows = rows_of(study)
    assert rows[0] == 80 and len(set(rows)) == 30
    assert study.trials[0].params == wanted and study.sampler.best(study).row == 80


def test_a_fixed_decimal_gets_the_rest_of_a_row_that_has_it():
    table = FeatureTable.from_arrays(GRID, np.column_stack([X, Y]))
    study = study_of(table, enqueued=[{"x": 0.3}] * 11)
    without_warning(study, summed(x=(0, 1), y=(0, 1)), 11)
    rows = rows_of(study)
    assert sorted(rows) == np.flatnonzero(np.isclose(X, 0.3)).tolist()
    assert {trial.params["x"] for trial in study.trials} == {0.3}


@pytest.mark.parametrize(
    "suggested",
    [
        FloatDistribution(0.0, 0.6),
        FloatDistribution(0.0, 0.6, step=0.1),
        CategoricalDistribution([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
    ],
)
def test_a_study_may_suggest_the_decimals_themselves(
    suggested,
):
    """Nothing beyond the end that it suggests is run."""
    column = np.arange(0.0, 0.65, 0.1)
    assert column[-1] > 0.6
    study = study_of(FeatureTable.from_arrays({"x": column}, column))
    without_warning(study, lambda trial: trial._suggest("x", suggested), 7)
    assert sorted(rows_of(study)) == list(range(7))
    assert max(trial.params["x"] for trial in study.trials) == 0.6
    rows = FeatureTable.from_arrays(
        {"x": column}, column, bounds={"x": (0.0, 0.6)}
    ).rows
    assert rows.parameters.max() == 0.6 and rows.find({"x": column[-1]}) == 6


def test_a_number_stands_for_a_choice_of_numbers():
    choices = CategoricalDistribution([*TENTHS.tolist(), "auto"])
    rows = rows_like({"x": [TENTHS[3], TENTHS[7], "auto"]}, space={"x": choices})
    assert [rows.find({"x": x}) for x in (0.3, 0.7, "auto", 0.35)] == [0, 1, 2, None]


# Printed numbers.
@pytest.mark.parametrize("digits", [8, 9, 12, 17])
@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 7e8])
def test_a_row_is_found_by_its_printed_numbers(digits, scale):
    rng = np.random.default_rng(1)
    columns = {name: scale * rng.normal(size=500) for name in "abc"}
    rows = rows_like(columns)
    for row in range(500):
        printed = {
            name: float(f"{column[row]:.{digits}g}") for name, column in columns.items()
        }
        assert rows.find(printed) == row
    off = {name: 1.000001 * float(column[7]) for name, column in columns.items()}
    assert rows.find(off) is None


def test_a_printed_number_at_the_end_of_a_range_is_its_row():
    rows = rows_like({"x": [0.5, 1.95962098]})
    assert rows.find({"x": 1.959621}) == 1
    table = FeatureTable.from_arrays({"x": [0.5, 1.95962098]}, [1.0, 2.0])
    study = study_of(table)
    without_warning(study, summed(x=(0.5, 1.959621)), 2)
    assert sorted(rows_of(study)) == [0, 1]
    narrower = study_of(FeatureTable.from_arrays({"x": [0.5, 1.95962102]}, [1.0, 2.0]))
    without_warning(narrower, summed(x=(0.5, 1.959621)), 2)
    assert max(trial.params["x"] for trial in narrower.trials) == 1.959621


def test_rows_that_are_nearer_than_the_tolerance_stay_apart():
    near = 1.0 + np.array([0.0, 1.0, 2.0, 3.0]) * 2e-9
    rows = rows_like({"x": near, "y": np.ones(4)})
    assert rows.offered.all()
    for row, x in enumerate(near.tolist()):
        assert rows.find({"x": x, "y": 1.0}) == row  # an equal one first
        assert rows.find({"x": x + 4e-10, "y": 1.0000000000000002}) in (row, None)
    assert rows.find({"x": 1.0, "y": 1.0 + 1e-16}) == 0
    mixed = rows_like({"x": [0.3, 0.1 + 0.2], "y": [5.0, 7.0]})
    assert [mixed.find({"x": 0.3, "y": y}) for y in (5.0, 7.0)] == [0, 1]
    assert mixed.having({"x": 0.3}).tolist() == [True, False]
    study = study_of(FeatureTable.from_arrays({"x": near}, near))
    without_warning(study, summed(x=(1, 2)), 4)
    assert sorted(rows_of(study)) == [0, 1, 2, 3]


def test_on_a_logarithmic_scale_no_row_swallows_its_neighbourhood():
    space = {"x": FloatDistribution(1e-9, 1.0, log=True)}
    rows = rows_like({"x": [1e-9, 1.0]}, space=space)
    assert rows.find({"x": 5e-7}) is None and rows.find({"x": 1e-9}) == 0
    decades = rows_like({"x": np.geomspace(1e-12, 1.0, 13)})
    assert decades.find({"x": 3e-12}) is None and decades.find({"x": 1e-11}) == 1


# Whole numbers.
def test_whole_numbers_are_whole():
    rows = rows_like({"id": np.array([1_000_000_001, 1_000_000_007, 3])})
    assert (
        rows.find({"id": 1_000_000_007}) == 1
        and rows.find({"id": 1_000_000_006}) is None
    )
    assert rows.find({"id": 3.0000000001}) == 2  # of a sheet of floats
    assert rows.find({"id": Decimal(3)}) == 2 and rows.find({"id": 10**400}) is None
    floats = rows_like({"id": np.array([1_000_000_001.0, 1_000_000_007.0])})
    assert floats.find({"id": 1_000_000_006.0}) is None
    assert floats.find({"id": 1_000_000_007.0}) == 1


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [
        ((9.5, 50.5), FloatDistribution(9.5, 50.5)),
        ((10, 50), IntDistribution(10, 50)),
        ((9.0, 51.9), FloatDistribution(9.0, 51.9)),
    ],
)
def test_bounds_of_whole_numbers_hold(bounds, expected):
    doses = np.arange(10, 51, 5)
    rows = rows_like({"dose": doses}, bounds={"dose": bounds})
    assert rows.space.as_dict() == {"dose": expected}


def test_nothing_beyond_declared_bounds_is_proposed():
    doses, costs = (
        np.arange(10, 51, 5),
        np.column_stack([np.arange(9.0), np.arange(9.0) + 0.5]),
    )
    bounds = {"dose": (9.5, 50.5)}
    table = FeatureTable.from_arrays({"dose": doses}, outcomes=costs, bounds=bounds)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
    study.optimize(lambda trial: trial.suggest_float("dose", 9, 51) / 10.0, n_trials=25)
    assert 9.5 <= min(trial.params["dose"] for trial in study.trials) < 10.0
    assert max(trial.params["dose"] for trial in study.trials) <= 50.5


# Values that a float, or a choice, cannot tell apart.
def test_ids_that_become_the_same_float_are_refused_and_others_kept():
    large = 2**60 + np.arange(3)
    for ids in (large, large.tolist(), [-1, 2**63 + 1, 5], [2**53 + 1, 2**53, 5]):
        with refused(r"^table.id\[\d\]: \d+ .* up to 2\^53, .* as choices"):
            rows_like({"id": ids})
    rows = rows_like({"id": 2**53 - np.arange(1, 4)})
    assert [rows.find({"id": 2**53 - step}) for step in (1, 2, 3, 4)] == [0, 1, 2, None]
    space = {"id": CategoricalDistribution(large.tolist())}
    choices = rows_like({"id": large.tolist()}, space=space)
    assert [choices.find({"id": number}) for number in large.tolist()] == [0, 1, 2]
    assert choices.find({"id": 2**60 + 3}) is None
    assert (
        rows_like({"id": [2**64 + number for number in range(3)]}).find(
            {"id": 2**64 + 1}
        )
        == 1
    )
    with refused(r"^table.features: 11529\d+ .* no two are the same float"):
        FeatureTable.from_arrays({"x": [0.0, 1.0, 2.0]}, large)
    assert FeatureTable.from_arrays(
        {"x": [0.0, 1.0]}, np.array([2**60, 2**61])
    ).rows.offered.all()


def test_decimals_are_numbers():
    column = [Decimal("1.50"), Decimal("1.75"), 2]
    rows = rows_like({"x": column})
    assert rows.space.as_dict() == {"x": FloatDistribution(1.5, 2.0)}
    assert [rows.find({"x": x}) for x in (1.5, Decimal("1.75"), 2)] == [0, 1, 2]
    table = FeatureTable.from_arrays({"x": column}, [1.0, 2.0, 3.0])
    sampler = FeatureKernelSampler(table, seed=1)
    study = optuna.create_study(storage="sqlite://", sampler=sampler)
    study.optimize(summed(x=(1, 2)), n_trials=3)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ([True, 1.0, False], "1.0"),
        ([1, True, 2.5], "True"),
        (["a", Decimal("1.5")], r"Decimal\('1.5'\)"),
        ([("a", 1), ("b", 2)], ""),
    ],
)
def test_choices_that_cannot_be_told_apart_or_kept_are_refused(column, value):
    with refused(rf"^table.x(\[\d\]|.shape): {value}"):
        rows_like({"x": column})


@pytest.mark.filterwarnings("ignore:FeatureTable")
def test_given_choices_that_are_equal_are_refused():
    space = {"x": CategoricalDistribution([1, True])}
    with refused(r"^table.x\[1\]: True .* it equals 1"):
        rows_like({"x": ["1", "2"]}, space=space)
    rows = rows_like({"x": ["auto", 1, 1.0]})  # one number
    assert rows.offered.tolist() == [True, True, False]
