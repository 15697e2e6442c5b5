"""The sampler's contract with Optuna, and that the score helps."""

import json
import multiprocessing
import pickle
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState

from study import DoGSampler, FeatureTable
from study.sampler.table_policy import TableExhaustedError
from taichi_nmm.errors import InputError

ROOT = Path(__file__).parents[3]
ROOMY = {"a": FloatDistribution(-1, 1), "b": FloatDistribution(0, 5)}


def bowl(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", -1, 1) ** 2 + 0.01 * trial.suggest_float("b", 0, 5)


def new_study(table: FeatureTable, direction: str = "minimize", seed: int = 1) -> optuna.Study:
    return optuna.create_study(sampler=DoGSampler(table, seed=seed), direction=direction)


def rows_of(study: optuna.Study) -> list[int]:
    return [trial.user_attrs["row"] for trial in study.get_trials(deepcopy=False)]


def rows_of_placed(study: optuna.Study) -> list[int]:
    return [trial.user_attrs["row"] for trial in study.trials if "row" in trial.user_attrs]


def test_trials_are_rows_and_no_row_comes_twice(table: FeatureTable) -> None:
    study = new_study(table)
    study.optimize(bowl, n_trials=30)
    rows = rows_of(study)
    assert len(set(rows)) == 30
    for trial, row in zip(study.trials, rows, strict=True):
        assert trial.params == table.rows.as_parameters(row)
        assert trial.user_attrs["score"] == table.rows.features[row, 0]


@pytest.mark.parametrize("direction", ["minimize", "maximize"])
def test_both_directions_find_the_best_rows(table: FeatureTable, direction: str) -> None:
    sign = 1.0 if direction == "minimize" else -1.0
    study = new_study(table, direction)
    study.optimize(lambda trial: sign * bowl(trial), n_trials=15)
    costs = table.rows.parameters[:, 0] ** 2 + 0.01 * table.rows.parameters[:, 1]
    assert sign * study.best_value <= np.sort(costs)[2]


def test_several_objectives_are_refused(table: FeatureTable) -> None:
    study = optuna.create_study(sampler=DoGSampler(table), directions=["minimize", "maximize"])
    with pytest.raises(ValueError, match="multi-objective"):
        study.ask(ROOMY)
    with pytest.raises(ValueError, match="multi-objective"):
        study.ask().suggest_float("other", 0, 1)


def test_rows_of_running_trials_are_not_proposed(table: FeatureTable) -> None:
    study = new_study(table)
    study.optimize(bowl, n_trials=5)
    for _ in range(40):
        study.ask(ROOMY)
    assert len(set(rows_of(study))) == 45


@pytest.mark.parametrize("state", [TrialState.FAIL, TrialState.PRUNED])
def test_failed_and_pruned_trials_teach_nothing(table: FeatureTable, state: TrialState) -> None:
    def rows(lose_a_trial: bool) -> list[int]:
        study = new_study(table)
        study.optimize(bowl, n_trials=6)
        if lose_a_trial:
            study.tell(study.ask(ROOMY), state=state)
        study.optimize(bowl, n_trials=1)
        return rows_of(study)

    lost, clean = rows(lose_a_trial=True), rows(lose_a_trial=False)
    assert lost[:7] == clean
    assert lost[7] not in lost[:7]
    score = table.rows.features[:, 0]  # it goes on where it was, as if nothing had been learned
    assert abs(score[lost[7]] - score[clean[6]]) < 0.2


def test_infinite_values_are_clipped(table: FeatureTable) -> None:
    study = new_study(table)
    values = iter([1.0, float("inf"), float("-inf"), 2.0, 3.0])

    def objective(trial: optuna.Trial) -> float:
        bowl(trial)
        return next(values)

    study.optimize(objective, n_trials=5)
    assert len(set(rows_of(study))) == 5


def test_an_exhausted_table_is_an_error_of_the_next_trial(table: FeatureTable) -> None:
    small = FeatureTable.from_arrays({"a": [0.0, 0.5, 1.0], "b": [0.0, 1.0, 2.0]}, [1, 2, 3])
    study = new_study(small)
    study.optimize(bowl, n_trials=3)
    with pytest.raises(TableExhaustedError, match="all 3 rows"):
        study.optimize(bowl, n_trials=1)
    assert [trial.state for trial in study.trials] == [TrialState.COMPLETE] * 3 + [TrialState.FAIL]


def test_a_table_of_one_row_has_one_trial(table: FeatureTable) -> None:
    study = new_study(FeatureTable.from_arrays({"a": [0.25], "b": [1.0]}, [0.0]))
    study.optimize(bowl, n_trials=1)
    assert study.best_params == {"a": 0.25, "b": 1.0}


def test_the_same_seed_proposes_the_same(table: FeatureTable) -> None:
    first, second, other = new_study(table), new_study(table), new_study(table, seed=2)
    for study in (first, second, other):
        study.sampler.reseed_rng()
        study.optimize(bowl, n_trials=10)
    assert rows_of(first) == rows_of(second) != rows_of(other)


def test_the_state_is_in_the_trials(table: FeatureTable) -> None:
    whole = new_study(table)
    whole.optimize(bowl, n_trials=12)
    pieces = optuna.create_study()
    for _ in range(12):  # a new sampler, pickled besides, for each trial
        pieces.sampler = pickle.loads(pickle.dumps(DoGSampler(table, seed=1)))
        pieces.optimize(bowl, n_trials=1)
    assert rows_of(pieces) == rows_of(whole)


def rows_of_a_run(table: FeatureTable, queue: "multiprocessing.Queue[list[int]]") -> None:
    study = new_study(table)
    study.optimize(bowl, n_trials=8)
    queue.put(rows_of(study))


def test_a_spawned_process_proposes_the_same(table: FeatureTable) -> None:
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    process = context.Process(target=rows_of_a_run, args=(table, queue))
    process.start()
    there = queue.get(timeout=60)
    process.join()
    study = new_study(table)
    study.optimize(bowl, n_trials=8)
    assert there == rows_of(study)


def test_a_sampler_over_a_store_pickles_small(store: Path) -> None:
    sampler = DoGSampler(FeatureTable.from_parquet(store, features=["phi_printed"]), seed=1)
    optuna.create_study(sampler=sampler).ask()
    assert len(pickle.dumps(sampler)) < 6000


def test_ties_are_broken_by_the_seed(table: FeatureTable) -> None:
    tied = FeatureTable.from_arrays({"a": np.linspace(0, 1, 50), "b": np.ones(50)}, np.zeros(50))
    seen = set()
    for seed in range(12):
        study = new_study(tied, seed=seed)
        study.optimize(bowl, n_trials=4)
        seen.add(rows_of(study)[3])
    assert len(seen) > 6


def test_extra_parameters_go_to_the_independent_sampler(table: FeatureTable) -> None:
    def objective(trial: optuna.Trial) -> float:
        value = bowl(trial)
        kind = trial.suggest_categorical("kind", ["x", "y"])
        return value + trial.suggest_int("n", 1, 9) + (kind == "x")

    studies = [new_study(table), new_study(table)]
    for study in studies:
        study.optimize(objective, n_trials=8)
    assert [t.params for t in studies[0].trials] == [t.params for t in studies[1].trials]
    assert len({t.params["n"] for t in studies[0].trials}) > 2
    assert len(set(rows_of(studies[0]))) == 8


def test_a_range_that_leaves_rows_out_is_an_error_before_the_objective(table: FeatureTable) -> None:
    evaluated = []

    def objective(trial: optuna.Trial) -> float:
        trial.suggest_float("a", -1, 1)
        evaluated.append(trial.suggest_float("b", 0.0, 1e-9))
        return 0.0

    with pytest.raises(InputError, match=r"b: .*high=1e-09.* a range that holds all rows"):
        new_study(table).optimize(objective, n_trials=1)
    assert evaluated == []


def test_a_wider_range_is_fine(table: FeatureTable) -> None:
    study = new_study(table)
    study.optimize(lambda t: t.suggest_float("a", -9, 9) + t.suggest_float("b", -9, 9), n_trials=5)
    assert len(set(rows_of(study))) == 5


def test_another_kind_of_parameter_is_an_error(table: FeatureTable) -> None:
    with pytest.raises(InputError, match=r"a: 'IntDistribution.* a range that holds all rows"):
        new_study(table).optimize(lambda trial: trial.suggest_int("a", -1, 1), n_trials=1)


def test_a_parameter_never_suggested_is_an_error_of_that_trial(table: FeatureTable) -> None:
    study = new_study(table)
    with pytest.raises(InputError, match="b: 'not suggested in trial 0'"):
        study.optimize(lambda trial: trial.suggest_float("a", -1, 1), n_trials=1)


@pytest.mark.filterwarnings("ignore:PartialFixedSampler is experimental")
def test_a_fixed_parameter_is_an_error(table: FeatureTable) -> None:
    sampler = optuna.samplers.PartialFixedSampler({"a": 0.5}, DoGSampler(table))
    with pytest.raises(InputError, match="a: 'fixed'"):
        optuna.create_study(sampler=sampler).optimize(bowl, n_trials=1)


def test_an_enqueued_row_is_learned_from_and_not_repeated(table: FeatureTable) -> None:
    study = new_study(table)
    study.enqueue_trial(table.rows.as_parameters(7))
    study.optimize(bowl, n_trials=1)
    for _ in range(59):
        study.ask(ROOMY)
    rows = [trial.user_attrs["row"] for trial in study.trials]
    assert rows[0] == 7 and len(set(rows)) == 60


def test_trials_off_the_table_are_ignored_with_one_warning(table: FeatureTable) -> None:
    study = new_study(table)
    study.enqueue_trial({"a": 0.123, "b": 4.0})
    with pytest.warns(UserWarning, match="such as trial 0") as warned:
        study.optimize(bowl, n_trials=6)
    assert len(warned) == 1
    assert len(set(rows_of_placed(study))) == 5


def test_startup_rows_are_random(table: FeatureTable) -> None:
    first = set()
    for seed in range(10):
        study = new_study(table, seed=seed)
        study.optimize(bowl, n_trials=1)
        first.add(rows_of(study)[0])
    assert len(first) > 5


def test_what_is_stored_are_plain_numbers(table: FeatureTable) -> None:
    study = new_study(table)
    study.optimize(bowl, n_trials=1)
    assert set(json.loads(json.dumps(study.trials[0].user_attrs))) == {"row", "score"}
    assert all(type(value) is float for value in study.trials[0].params.values())


def test_an_informative_score_beats_random_search() -> None:
    rng = np.random.default_rng(5)
    unit = rng.uniform(size=(3000, 8))
    depth = ((unit - 0.6) ** 2).sum(axis=1)
    cost = 1.0 - np.exp(-8.0 * depth)
    score = np.maximum(0.0, 20.0 - 40.0 * depth + rng.normal(0, 3, 3000))  # most are zero
    columns = {f"x{i}": unit[:, i] for i in range(8)}
    table = FeatureTable.from_arrays(columns, score, bounds=dict.fromkeys(columns, (0.0, 1.0)))

    def objective(trial: optuna.Trial) -> float:
        x = np.array([trial.suggest_float(name, 0, 1) for name in columns])
        return float(1.0 - np.exp(-8.0 * ((x - 0.6) ** 2).sum()))

    def mean_best(samplers: list[optuna.samplers.BaseSampler]) -> float:
        best = []
        for sampler in samplers:
            study = optuna.create_study(sampler=sampler)
            study.optimize(objective, n_trials=20)
            best.append(study.best_value)
        return float(np.mean(best))

    dog = mean_best([DoGSampler(table, seed=seed) for seed in range(6)])
    random = mean_best([optuna.samplers.RandomSampler(seed=seed) for seed in range(6)])
    assert dog < random - 0.1
    assert dog < np.quantile(cost, 0.01)


def test_a_proposal_from_100000_rows_takes_no_half_second() -> None:
    rng = np.random.default_rng(0)
    score = np.maximum(0.0, rng.normal(-3, 8, 100_000))  # two thirds are zero
    columns = {f"x{i}": rng.uniform(size=100_000) for i in range(16)}
    big = FeatureTable.from_arrays(columns, score)
    study = new_study(big)
    space = {name: FloatDistribution(0, 1) for name in columns}
    for row in range(100):
        study.add_trial(
            optuna.create_trial(
                params=big.rows.as_parameters(row),
                distributions=space,
                user_attrs={"row": row},
                value=float(np.exp(-score[row] / 10) + 0.1 * rng.normal()),
            )
        )
    times = []
    for _ in range(3):
        start = time.perf_counter()
        study.ask(space)
        times.append(time.perf_counter() - start)
    assert min(times) < 0.5


def test_importing_the_package_loads_neither_taichi_nor_matplotlib() -> None:
    code = "import sys, study; print({'taichi', 'matplotlib', 'torch'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "set()"
