"""The files of the problems from outside: complete, sound, unchanged, and as their makers say."""

import hashlib

import numpy as np
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from scipy.stats import spearmanr

from study.benchmarks.outside import catalogue
from study.benchmarks.outside.candidate_pool import pool
from study.benchmarks.outside.catalogue import PROBLEMS, REPORTED, TUNING, definition
from study.benchmarks.outside.making import described, rows_of
from study.benchmarks.outside.outside_problem import digest, file_of, outside_problem
from taichi_nmm.errors import InputError

# Of names, parameters, features and cost. Other numbers are another problem: figures made with the
# old ones must be made again.
DIGESTS = {
    "digits-network": "919632c690f2a73b",
    "transport-solver": "6d51af5a2bb14237",
    "cluster-evolution": "5d0d1e116e6a8ad0",
    "tumour-boosting": "1a495df8295b6a6a",
    "cart-pole": "9bf9a956a3fd60a3",
    "stiff-reactions": "2a9aa0e97ba72051",
}
MOST_KB = 150
AGAIN = (3, 500, 901)  # rows computed again


def content_digest(name: str) -> str:
    problem = outside_problem(name)
    found = hashlib.sha256(repr((name, [*problem.columns], problem.feature_names)).encode())
    for column in problem.columns.values():
        found.update(repr(column.tolist()).encode())
    found.update(np.ascontiguousarray(problem.features).tobytes())
    found.update(problem.cost.tobytes())
    return found.hexdigest()[:16]


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_file_has_a_pool_its_features_and_finite_costs(name: str) -> None:
    problem = outside_problem(name)
    assert problem.name == name
    assert problem.purpose == ("tuning" if name in TUNING else "reported")
    assert 1000 <= len(problem) <= 1500
    assert 4 <= len(problem.space) <= 8
    assert 2 <= len(problem.feature_names) <= 6
    assert problem.features.shape == (len(problem), len(problem.feature_names))
    assert np.isfinite(problem.cost).all()
    assert problem.best == problem.cost.min()
    assert problem.made_by == f"python tools/make_outside.py --problem {name}"
    assert file_of(name).stat().st_size < 1000 * MOST_KB


@pytest.mark.parametrize("name", PROBLEMS)
def test_parameters_are_mixed_and_lie_in_their_space(name: str) -> None:
    problem = outside_problem(name)
    kinds: set[object] = set()
    for parameter, distribution in problem.space.items():
        values = problem.columns[parameter].tolist()
        assert all(distribution._contains(distribution.to_internal_repr(v)) for v in values)
        assert len(set(values)) > 1
        kinds |= {type(distribution)} | ({"log"} if getattr(distribution, "log", False) else set())
    assert kinds >= {CategoricalDistribution, FloatDistribution, "log"}
    rows = [tuple(row.values()) for row in rows_of(problem.columns)]
    assert len(set(rows)) == len(rows)


@pytest.mark.parametrize("name", PROBLEMS)
def test_numbers_are_those_that_figures_were_made_with(name: str) -> None:
    assert content_digest(name) == DIGESTS[name]
    assert digest(name) == hashlib.sha256(file_of(name).read_bytes()).hexdigest()


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_problem_is_neither_flat_nor_easy_nor_without_a_clue(name: str) -> None:
    """Half the rows differ clearly from the best, ten random rows do not find it, features help."""
    problem = outside_problem(name)
    order = np.sort(problem.cost)
    assert len(np.unique(problem.cost)) > 0.5 * len(problem)
    rng = np.random.default_rng(0)
    drawn = [problem.cost[rng.permutation(len(problem))[:10]].min() for _ in range(200)]
    assert np.median(drawn) > order[5]
    worth = [abs(spearmanr(ranks, problem.cost).statistic) for ranks in problem.ranks.T]
    assert 0.4 <= max(worth) <= 0.97


@pytest.mark.parametrize("name", PROBLEMS)
def test_rows_are_what_their_maker_computes(name: str) -> None:
    if name == "cart-pole":
        pytest.importorskip("mujoco", reason="MuJoCo is not installed: cart-pole is not simulated")
    problem, made = outside_problem(name), definition(name)
    for row in AGAIN:
        settings = problem.settings(row)
        # Other builds of BLAS and LAPACK add in other orders, which iterations enlarge.
        np.testing.assert_allclose(made.cheap(settings), problem.features[row], rtol=1e-3)
        assert made.costly(settings) == pytest.approx(problem.cost[row], rel=1e-3)


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_file_says_what_its_definition_says(name: str) -> None:
    if name == "cart-pole":
        pytest.importorskip("mujoco", reason="MuJoCo is not installed: cart-pole is not defined")
    problem, made = outside_problem(name), definition(name)
    assert problem.space == dict(made.space)
    assert problem.feature_meanings == dict(made.features)
    assert (problem.field, problem.cost_meaning) == (made.field, made.cost_meaning)
    assert problem.made_by == described(made)["command"]


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_pool_is_decided_by_the_name(name: str) -> None:
    problem = outside_problem(name)
    drawn = pool(name, problem.space)
    for parameter, column in drawn.items():
        np.testing.assert_array_equal(column, problem.columns[parameter])
    others = pool(name + "-other", problem.space)
    assert any((drawn[parameter] != others[parameter]).any() for parameter in drawn)


@pytest.mark.parametrize("name", PROBLEMS)
def test_choices_and_integers_have_equal_shares_of_the_pool(name: str) -> None:
    problem = outside_problem(name)
    for parameter, distribution in problem.space.items():
        _, counts = np.unique(problem.columns[parameter], return_counts=True)
        equal = isinstance(distribution, CategoricalDistribution) or (
            isinstance(distribution, IntDistribution) and not distribution.log
        )
        if equal:
            assert counts.max() - counts.min() <= 2


def test_there_are_three_to_tune_on_and_three_to_report() -> None:
    assert len(TUNING) == len(REPORTED) == 3
    fields = {outside_problem(name).field for name in PROBLEMS}
    assert len(fields) == len(PROBLEMS)


def test_an_unknown_problem_is_one_line() -> None:
    for refused in (outside_problem, definition, file_of):
        with pytest.raises(InputError, match=r"^problem: 'easy'.*digits-network.*stiff-reactions$"):
            refused("easy")  # type: ignore[operator]


def test_a_problem_whose_package_is_missing_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> None:
        raise ModuleNotFoundError(name="mujoco")

    monkeypatch.setattr(catalogue, "import_module", missing)
    with pytest.raises(InputError, match="mujoco installed"):
        definition("cart-pole")
