"""Points over a space and near others, and the forms of a space."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from study import FeatureTable
from study.sampler import space as spaces
from study.sampler.space import (
    Space,
    anywhere,
    as_suggested,
    first_not_taken,
    nearby,
    not_among,
    not_near,
)
from tests.study.sampler.studies import params_of, study_of

DISTRIBUTIONS = {
    "plain": FloatDistribution(-2.0, 3.0),
    "log": FloatDistribution(1e-5, 10.0, log=True),
    "step": FloatDistribution(-1.0, 1.0, step=0.25),
    "int": IntDistribution(3, 9),
    "int_step": IntDistribution(0, 10, step=2),
    "int_log": IntDistribution(1, 1000, log=True),
    "choice": CategoricalDistribution(["x", "y", "z"]),
    "single": FloatDistribution(4.0, 4.0),
}
SPACE = Space.of(DISTRIBUTIONS)


def inside(points):
    return all(
        distribution._contains(distribution.to_internal_repr(SPACE.values(point)[name]))
        for point in points
        for name, distribution in DISTRIBUTIONS.items()
    )


def test_points_anywhere_are_values_of_their_distributions():
    points = anywhere(SPACE, 500, np.random.default_rng(0))
    assert inside(points)
    assert_allclose(np.median(points[:, 1]), 1e-2, rtol=0.5)  # evenly over decades
    assert set(points[:, 3]) == set(range(3, 10))
    assert_allclose(np.bincount(points[:, 6].astype(int)) / 500, 1 / 3, atol=0.07)


def test_points_near_others_are_near_and_inside():
    rng = np.random.default_rng(0)
    centre = anywhere(SPACE, 1, rng)
    points = nearby(SPACE, centre, 800, rng)
    assert inside(points)
    distance = np.linalg.norm(SPACE.unit(points) - SPACE.unit(centre), axis=1)
    others = np.linalg.norm(
        SPACE.unit(anywhere(SPACE, 800, rng)) - SPACE.unit(centre), axis=1
    )
    assert np.median(distance) < 0.3 * np.median(others)
    assert np.mean(distance > 0) > 0.8
    unmoved = np.mean(points[:, 0] == nearby(SPACE, centre, 1, rng)[0, 0])
    assert 0.0 <= unmoved < 1.0


def test_rows_and_values_of_pythons_own_types_are_each_others_inverse():
    points = anywhere(SPACE, 50, np.random.default_rng(1))
    assert_allclose([SPACE.row(SPACE.values(point)) for point in points], points)
    assert_allclose(SPACE.from_fractions(SPACE.fractions(points)), points, rtol=1e-9)
    expected = [float, float, float, int, int, int, str, float]
    assert [type(value) for value in SPACE.values(points[0]).values()] == expected


def test_taken_points_are_left_out_unless_nothing_is_left_and_the_first_misfit_is_found():
    points = np.array([[0.0, 1.0], [2.0, 3.0]])
    assert not_among(points, points[:1]).tolist() == [False, True]
    assert not_among(points, points).tolist() == [True, True]
    assert not_among(points, np.empty((0, 2))).all()
    unit = np.array([[0.5, 0.5], [0.509, 0.5], [0.511, 0.5], [0.5, 0.9]])
    assert not_near(unit, unit[:1]).tolist() == [False, False, True, True]
    assert not_near(unit, np.empty((0, 2))).all()
    kinds = CategoricalDistribution(["x", "y", "z"])
    values = np.array([2.0, 0.0, 2.0, 1.0, 1.0])
    assert first_not_taken(kinds, values, CategoricalDistribution(["z", "x"])) == 3
    assert first_not_taken(FloatDistribution(0, 9), values, IntDistribution(1, 9)) == 1


@pytest.mark.parametrize(
    ("distribution", "value", "expected"),
    [
        (FloatDistribution(0, 1), 1, 1.0),
        (FloatDistribution(0, 1), 1.5, None),
        (FloatDistribution(0, 1), True, None),
        (FloatDistribution(0, 1), "1", None),
        (FloatDistribution(1, 2, log=True), 2.0, 2.0),
        (FloatDistribution(0, 1, step=0.1), 0.3, 0.3),
        (FloatDistribution(0, 1, step=0.1), 0.35, None),
        (IntDistribution(0, 9), 3.0, 3),
        (IntDistribution(0, 9), 3.5, None),
        (IntDistribution(0, 9, step=3), 4, None),
        (IntDistribution(1, 9, log=True), 0, None),
        (CategoricalDistribution([4, 2, "x"]), 2.0, 2),
        (CategoricalDistribution([4, 2, "x"]), "y", None),
        (CategoricalDistribution([True, False]), 1, True),
    ],
)
def test_values_become_what_another_distribution_has(distribution, value, expected):
    own = CategoricalDistribution([value])
    assert first_not_taken(own, np.zeros(2), distribution) == (
        0 if expected is None else None
    )
    if isinstance(value, int | float):
        numeric, numbers = FloatDistribution(-9, 9), np.array([float(value)])
        flag = isinstance(value, bool)  # a number to NumPy
        fits = first_not_taken(numeric, numbers, distribution) is None
        assert flag or fits == (expected is not None)
    if expected is None:
        with pytest.raises(ValueError):
            as_suggested(distribution, value)
        return
    found = as_suggested(distribution, value)
    assert found == expected and type(found) is type(expected)


@pytest.mark.parametrize(
    "values",
    [{"plain": "0"}, {"plain": True}, {"plain": None}, {"choice": "q"}, {"log": -1.0}],
)
def test_what_a_space_has_no_number_for_is_no_row(values):
    whole = SPACE.values(anywhere(SPACE, 1, np.random.default_rng(0))[0])
    assert SPACE.row(whole) is not None
    assert SPACE.row({"plain": 0.0}) is None  # others are missing
    assert SPACE.row(whole | values) is None


def test_pinned_values_are_those_of_all_new_points():
    rng = np.random.default_rng(0)
    pinned = SPACE.pinned({"plain": 7.0, "choice": "y", "int": "no number", "other": 1})
    points = anywhere(pinned, 50, rng)
    for new in (points, nearby(pinned, points[:3], 50, rng)):
        assert (new[:, 0] == 7.0).all()
        assert (new[:, 6] == 1.0).all()
        assert len(set(new[:, 3])) > 3


def test_the_unit_cube_has_ranges_of_one_choices_one_apart_and_edges():
    space = Space.of({name: DISTRIBUTIONS[name] for name in ("plain", "log", "choice")})
    ends = (-2.0, 1e-5, "x"), (3.0, 10.0, "z")
    rows = [space.row(dict(zip(space.names, end, strict=True))) for end in ends]
    a, b = space.unit(np.array(rows))
    assert_allclose(np.abs(a - b)[:2], 1.0)
    assert_allclose(np.linalg.norm((a - b)[2:]), 1.0)
    space = Space.of(
        {name: DISTRIBUTIONS[name] for name in ("plain", "log", "int", "single")}
    )
    rows = np.array([[5.5, 1e3, 9.0, 4.0], [0.5, 1e-2, 12.0, 5.0]])
    edges = [[1.0, 1.0, 6.5 / 7, 0.0], [0.5, 0.5, 6.5 / 7, 0.0]]
    assert_allclose(space.unit(rows), edges)


def test_in_many_dimensions_proposals_are_those_without_a_word_of_repeats(monkeypatch):
    rng = np.random.default_rng(0)
    rows, places = rng.random((300, 16)), rng.random((8, 16))
    outcomes = 0.1 + ((rows[:, None] - places) ** 2).sum(axis=2)
    names = [f"x{place}" for place in range(16)]
    space = dict.fromkeys(names, FloatDistribution(0.0, 1.0))
    columns = dict(zip(names, rows.T, strict=True))
    known = FeatureTable.from_arrays(columns, outcomes=outcomes, space=space)

    def objective(trial):
        at = np.array([trial.suggest_float(name, 0, 1) for name in names])
        return float(0.1 + ((at - 0.4) ** 2).sum())

    with_repeats = study_of(known, objective, 15)
    monkeypatch.setattr(spaces, "REPEAT", 0.0)
    assert params_of(study_of(known, objective, 15)) == params_of(with_repeats)
