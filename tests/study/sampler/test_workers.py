"""Several processes on one study: no row is proposed twice, and nothing is lost."""

import multiprocessing
import time
from collections import Counter

import numpy as np
import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from storage.databases.studies import open_studies
from study import DoGSampler, FeatureKernelSampler, FeatureTable
from study.sampler.gp import Posterior
from study.sampler.history import is_own
from tests.study.sampler.studies import summed

pytestmark = pytest.mark.slow

TRIALS = 200
ROWS = 215  # hardly more than trials: the end of the table is fought for


def small_table():
    rng = np.random.default_rng(0)
    columns = {"a": rng.uniform(size=ROWS), "b": rng.uniform(size=ROWS)}
    # Ten scores: many ties.
    return FeatureTable.from_arrays(columns, np.round(columns["a"], 1))


def open_storage(kind, folder):
    if kind == "journal":
        return JournalStorage(JournalFileBackend(str(folder / "journal.log")))
    return open_studies(f"sqlite:///{folder / 'studies.db'}")  # WAL


cost = summed(a=(0, 1), b=(0, 1))


def work(kind, folder, trials):
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    sampler = DoGSampler(small_table(), seed=1)
    study = optuna.load_study(
        study_name="s", storage=open_storage(kind, folder), sampler=sampler
    )
    study.optimize(cost, n_trials=trials)


@pytest.mark.parametrize(
    ("kind", "workers"),
    [
        ("journal", 4),
        ("sqlite", 2),
        pytest.param("sqlite", 4, marks=pytest.mark.campaign),
    ],
)
def test_no_row_is_proposed_twice(kind, workers, tmp_path):
    trials = TRIALS if workers == 4 and kind == "sqlite" else TRIALS // 2
    optuna.create_study(study_name="s", storage=open_storage(kind, tmp_path))
    context = multiprocessing.get_context("spawn")
    given = {"target": work, "args": (kind, tmp_path, trials // workers)}
    processes = [context.Process(**given) for _ in range(workers)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(timeout=200)
    assert [process.exitcode for process in processes] == [0] * workers
    study = optuna.load_study(study_name="s", storage=open_storage(kind, tmp_path))
    assert all(trial.state is TrialState.COMPLETE for trial in study.trials)
    rows = Counter(trial.user_attrs["row"] for trial in study.trials)
    assert len(rows) == sum(rows.values()) == trials
    table = small_table().rows
    assert all(
        t.params == table.as_parameters(t.user_attrs["row"]) for t in study.trials
    )


def test_of_two_that_want_one_row_the_later_gives_way():
    table = small_table()
    study = optuna.create_study(sampler=DoGSampler(table, seed=0))
    first, second = study.ask(), study.ask()
    first.set_user_attr("row", 7)
    rows = table.rows
    assert is_own(rows, study, study.trials[first.number], 7)
    second.set_user_attr("row", 7)
    assert not is_own(rows, study, study.trials[second.number], 7)


def test_threads_share_a_sampler():
    def slow(trial):
        time.sleep(0.002)
        return cost(trial)

    study = optuna.create_study(sampler=DoGSampler(small_table(), seed=0))
    study.optimize(slow, n_trials=60, n_jobs=4)
    assert len({trial.user_attrs["row"] for trial in study.trials}) == 60


@pytest.mark.parametrize("kernel", ["additive", "rbf"])
@pytest.mark.parametrize("conditioned", [True, False])
def test_running_trials_are_conditioned_on(conditioned, kernel, monkeypatch):
    """With nothing learned from those that run, all workers crowd around one score."""
    if not conditioned:
        monkeypatch.setattr(Posterior, "believing", lambda posterior, points: posterior)
    a = np.linspace(0, 1, 400)
    table = FeatureTable.from_arrays({"a": a}, a)
    space = table.rows.space.as_dict()
    study = optuna.create_study(
        sampler=FeatureKernelSampler(table, seed=0, kernel=kernel)
    )
    study.optimize(lambda t: (t.suggest_float("a", 0, 1) - 0.5) ** 2, n_trials=4)
    asked = [study.ask(space).params["a"] for _ in range(6)]
    neighbours = 5 / 399  # how wide six rows side by side are
    assert bool(np.ptp(asked) > 2 * neighbours) is conditioned
    assert len(set(asked)) == 6
