"""Results of an experiment as studies that Optuna and its dashboard read."""

import numpy as np
import optuna
import pyarrow as pa
import pytest
from optuna_dashboard import get_note

from storage.databases.bulk import study_ids, trial_counts
from storage.databases.studies import open_studies
from study.experiment.database import check_database, export
from study.experiment.folder import as_if_gone_on, fingerprint
from study.experiment.objective import Objective
from study.report.markdown import dashboard_summary
from taichi_nmm.body import Build
from taichi_nmm.parameters import GAINS
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Ground
from tests.cases import refused
from tests.study.experiment.fake_results import experiment, results

TINY = experiment()
SIX = (
    "tiny/dog/run-000",
    "tiny/dog/run-001",
    "tiny/random/run-000",
    "tiny/random/run-001",
)
GONE = ("dog", 0, 2)  # after a trial that walked


@pytest.fixture
def url(tmp_path):
    return f"sqlite:///{tmp_path}/studies.db"


def put(url, table, final=True, of=TINY):
    export(of, table, url, dashboard_summary, final=final)


def load(url, name):
    return optuna.load_study(study_name=name, storage=open_studies(url))


def test_every_arm_and_run_is_a_study(url, tmp_path):
    put(url, results(TINY))
    assert trial_counts(open_studies(url)) == {
        **dict.fromkeys(SIX, 3),
        "tiny/summary": 0,
    }
    study = load(url, "tiny/dog/run-001")
    assert study.direction.name == "MINIMIZE"
    assert study.user_attrs == {
        "experiment": "tiny",
        "arm": "dog",
        "run": 1,
        "experiment_config": fingerprint(TINY),
    }
    without = f"sqlite:///{tmp_path}/without.db"
    export(TINY, results(TINY), without, None, final=True)
    assert trial_counts(open_studies(without)) == dict.fromkeys(SIX, 3)


@pytest.mark.slow
def test_studies_say_what_their_objective_is_called(url, tmp_path):
    """A name of the user's stays."""
    put(url, results(TINY), final=False)
    names = (*SIX, "tiny/summary")
    assert [load(url, name).metric_names for name in names] == [["smooth_cost"]] * len(
        names
    )
    load(url, SIX[1]).set_metric_names(["mine"])
    put(url, results(TINY))
    assert load(url, SIX[1]).metric_names == ["mine"]
    assert [load(url, n).metric_names for n in names if n != SIX[1]] == [
        ["smooth_cost"]
    ] * 4


@pytest.mark.parametrize("searched", [(), ("theta_ref",)])
def test_trials_are_the_rows(url, searched):
    ours = experiment(searched=searched)
    table = results(ours)
    put(url, table, of=ours)
    rows = [row for row in table.to_pylist() if (row["arm"], row["run"]) == ("dog", 0)]
    trials = load(url, "tiny/dog/run-000").trials
    assert [trial.number for trial in trials] == [0, 1, 2]
    for trial, row in zip(trials, rows, strict=True):
        assert list(trial.params) == [*(gain.name for gain in GAINS), *searched]
        assert trial.params == {name: row[name] for name in trial.params}
        assert trial.distributions == ours.space
        assert trial.value == row["cost"]
        assert trial.user_attrs == {name: row[name] for name in trial.user_attrs}
    assert set(trials[0].user_attrs) == {
        "duration_s",
        "distance_m",
        "mean_speed_mps",
        "end_reason",
        "walked",
        "row",
        "phi_printed",
        "phi_corrected",
        "survived_fraction",
    }


@pytest.mark.slow
def test_later_exports_add_what_is_new(url):
    put(url, results(TINY, runs=1, trials=2, arms=("dog",)), final=False)
    before = load(url, SIX[0]).trials
    put(url, results(TINY, runs=1), final=False)
    put(url, results(TINY).take(pa.array(np.random.default_rng(0).permutation(12))))
    put(url, results(TINY, trials=1))  # fewer than there are: nothing to do
    assert trial_counts(open_studies(url)) == {
        **dict.fromkeys(SIX, 3),
        "tiny/summary": 0,
    }
    assert load(url, SIX[0]).trials[:2] == before
    assert [trial.value for trial in load(url, SIX[0]).trials] == [300.0, 90.0, 280.0]


def test_studies_that_ended_with_a_walker(url):
    """The database has the trials that were; the summary compares the arms as if all went on."""
    table = results(TINY)
    rows = [
        row
        for row in table.to_pylist()
        if (row["arm"], row["run"], row["trial"]) != GONE
    ]
    ended = pa.Table.from_pylist(rows, schema=table.schema)
    put(url, ended, of=experiment(until_walker=True))
    counts = dict.fromkeys(SIX, 3) | {"tiny/dog/run-000": 2, "tiny/summary": 0}
    assert trial_counts(open_studies(url)) == counts
    ids = study_ids(open_studies(url))
    wanted = dashboard_summary("tiny", as_if_gone_on(ended), True, ids)
    assert get_note(load(url, "tiny/summary")) == wanted


@pytest.mark.slow
def test_another_configuration_is_refused_and_nothing_written(url):
    put(url, results(TINY, trials=1), final=False)
    changes = (
        {"seed": 8},
        {"objective": Objective("walking")},
        {"build": Build(0.2)},
        {"searched": ("theta_ref",)},
        {"ground": Ground("flat")},
        {"duration_s": 3.0},
    )
    for other in (experiment(**change) for change in changes):
        with refused("storage: .*another configuration"):
            check_database(other, url)
        with refused("storage: .*another configuration"):
            put(url, results(other), of=other)
    assert max(trial_counts(open_studies(url)).values()) == 1
    check_database(experiment(runs=9, trials=50, arms=("dog",)), url)  # decide no trial
    check_database(experiment(settings=Settings(arch="auto", threads=1)), url)
    check_database(experiment(name="other", seed=8), url)
