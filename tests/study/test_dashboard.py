"""What the dashboard's pages are drawn from: its own API, over a study made by the sampler.

The history page draws each trial's number and values; the parallel-coordinate page draws values and
`param_internal_value` on axes taken from the search space; the table offers user attributes.
"""

import io
import json
from typing import Any
from wsgiref.util import setup_testing_defaults
from wsgiref.validate import validator

import numpy as np
import optuna
import optuna_dashboard
import pytest

from storage.databases.studies import open_studies
from study import FeatureKernelSampler, FeatureTable

pytestmark = pytest.mark.slow

TRIALS = 12
BOUNDS = {"speed": (0.0, 1.0), "angle": (-5.0, 5.0)}


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> optuna.Study:
    """A finished study of 12 trials, one that failed and one that is running, in SQLite."""
    path = tmp_path_factory.mktemp("dashboard") / "studies.db"
    rng = np.random.default_rng(0)
    columns = {name: rng.uniform(low, high, 80) for name, (low, high) in BOUNDS.items()}
    features = np.abs(columns["speed"] - 0.3)[:, None]
    sampler = FeatureKernelSampler(FeatureTable.from_arrays(columns, features), seed=1)
    study = optuna.create_study(
        sampler=sampler, storage=open_studies(f"sqlite:///{path}"), study_name="throw/features"
    )
    study.optimize(distance, n_trials=TRIALS)
    study.tell(study.ask(), state=optuna.trial.TrialState.FAIL)
    study.ask().suggest_float("speed", *BOUNDS["speed"])
    return study


def distance(trial: optuna.Trial) -> float:
    speed, angle = (trial.suggest_float(name, *BOUNDS[name]) for name in BOUNDS)
    return abs(speed - 0.3) + 0.01 * abs(angle)


def get(study: optuna.Study, path: str) -> Any:
    """One request to the dashboard's application, without a socket."""
    return json.loads(get_bytes(study, path))


def get_bytes(study: optuna.Study, path: str) -> bytes:
    statuses: list[str] = []
    environment: dict[str, Any] = {"PATH_INFO": path, "SCRIPT_NAME": "", "QUERY_STRING": ""}
    environment["wsgi.errors"] = io.StringIO()
    setup_testing_defaults(environment)
    application = validator(optuna_dashboard.wsgi(study._storage))
    answer = application(environment, lambda status, *_: statuses.append(status))
    body = b"".join(answer)
    answer.close()  # type: ignore[attr-defined]
    assert statuses == ["200 OK"], body
    return body


@pytest.fixture(scope="module")
def detail(study: optuna.Study) -> Any:
    return get(study, f"/api/studies/{study._study_id}")


def test_the_list_of_studies_names_it(study: optuna.Study) -> None:
    (listed,) = get(study, "/api/studies")["study_summaries"]
    assert listed["study_name"] == "throw/features"
    assert listed["directions"] == ["minimize"]
    assert listed["study_id"] == study._study_id


def test_the_history_page_has_every_value(study: optuna.Study, detail: Any) -> None:
    shown = {trial["number"]: trial for trial in detail["trials"]}
    assert len(shown) == TRIALS + 2
    for trial in study.trials[:TRIALS]:
        assert shown[trial.number]["state"] == "Complete"
        assert shown[trial.number]["values"] == [trial.value]
        assert shown[trial.number]["datetime_complete"]
    assert [shown[TRIALS]["state"], shown[TRIALS + 1]["state"]] == ["Fail", "Running"]
    assert [best["number"] for best in detail["best_trials"]] == [study.best_trial.number]


def test_the_parallel_coordinate_page_has_every_axis(study: optuna.Study, detail: Any) -> None:
    axes = {axis["name"]: axis["distribution"] for axis in detail["union_search_space"]}
    assert {name: (axis["low"], axis["high"]) for name, axis in axes.items()} == BOUNDS
    assert all(axis["type"] == "FloatDistribution" for axis in axes.values())
    for trial, shown in zip(study.trials[:TRIALS], detail["trials"][:TRIALS], strict=True):
        drawn = {param["name"]: param["param_internal_value"] for param in shown["params"]}
        assert drawn == trial.params
        assert all(BOUNDS[name][0] <= value <= BOUNDS[name][1] for name, value in drawn.items())


def test_the_table_page_has_the_samplers_notes(study: optuna.Study, detail: Any) -> None:
    sortable = {column["key"] for column in detail["union_user_attrs"] if column["sortable"]}
    assert "row" in sortable
    first = {item["key"]: item["value"] for item in detail["trials"][0]["user_attrs"]}
    assert first["row"] == str(study.trials[0].user_attrs["row"])


def test_importances_are_computed(study: optuna.Study) -> None:
    (found,) = get(study, f"/api/studies/{study._study_id}/param_importances")["param_importances"]
    importance = {item["name"]: item["importance"] for item in found}
    assert importance["speed"] > importance["angle"]


def test_the_page_itself_is_served(study: optuna.Study) -> None:
    assert b"<html" in get_bytes(study, f"/dashboard/studies/{study._study_id}").lower()
