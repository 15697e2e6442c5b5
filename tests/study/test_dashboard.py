"""The dashboard's answers: to whom, which files, and what its pages draw of a study of the sampler.

The history page draws each trial's number and values; the parallel-coordinate page draws values and
`param_internal_value` on axes taken from the search space; the table offers user attributes.
"""

import io
import json
from pathlib import Path
from typing import Any
from wsgiref.util import setup_testing_defaults
from wsgiref.validate import validator

import numpy as np
import optuna
import pytest
from optuna.storages import InMemoryStorage

from storage.databases.studies import open_studies
from study import FeatureKernelSampler, FeatureTable
from study.commands.dashboard import guarded_dashboard
from study.loopback import Application, guarded


def get(application: Application, path: str, **changes: str) -> tuple[int, dict[str, str], bytes]:
    """Status, headers by lower-case name, and body; changes are of the environment."""
    environment: dict[str, Any] = {"PATH_INFO": path, "SCRIPT_NAME": "", "QUERY_STRING": ""}
    environment |= {"HTTP_HOST": "127.0.0.1:8080", "wsgi.errors": io.StringIO(), **changes}
    setup_testing_defaults(environment)
    found: list[tuple[str, list[tuple[str, str]]]] = []
    answer = validator(application)(environment, lambda *given: found.append(given[:2]))
    body = b"".join(answer)
    answer.close()  # type: ignore[attr-defined]
    ((status, headers),) = found
    return int(status[:3]), {name.lower(): value for name, value in headers}, body


HTML = b"<script>alert(1)</script>"
PICTURE, PAGE, LINK, GONE, VECTOR = (f"{number:08d}-0000" for number in range(1, 6))
TYPES = {PICTURE: "image/png", PAGE: "text/html", LINK: "image/png", GONE: "image/png",
         VECTOR: "image/svg+xml"}  # fmt: skip
PLACE = "/artifacts/0/0"  # of the files of the one trial


@pytest.fixture
def storage() -> InMemoryStorage:
    """Of a study whose database names files of a folder."""
    storage = InMemoryStorage()
    trial = optuna.create_study(storage=storage, study_name="a").ask()
    for name, kind in TYPES.items():
        meta = {"artifact_id": name, "filename": "a", "mimetype": kind, "encoding": None}
        storage.set_trial_system_attr(trial._trial_id, f"artifacts:{name}", json.dumps(meta))
    return storage


@pytest.fixture
def dashboard(storage: InMemoryStorage, tmp_path: Path) -> Application:
    artifacts = tmp_path / "artifacts"
    artifacts.mkdir()
    for name in (PICTURE, PAGE, VECTOR):
        (artifacts / name).write_bytes(HTML)
    (tmp_path / "secret").write_bytes(b"secret")
    (artifacts / LINK).symlink_to(tmp_path / "secret")
    return guarded_dashboard(storage, artifacts)


HOST, ORIGIN = "HTTP_HOST", "HTTP_ORIGIN"


@pytest.mark.parametrize(("header", "value", "status"), [
    *((HOST, host, 200) for host in (
        "127.0.0.1:8080", "localhost", "LOCALHOST:1", "[::1]:8080",
    )),
    *((HOST, host, 403) for host in (
        "evil.example", "evil.example:8080", "127.0.0.1.evil.example", "localhost\n", "",
        "localhost.evil.example:8080", "localhost@evil.example",
    )),
    (ORIGIN, "http://127.0.0.1:8080", 200), (ORIGIN, "http://localhost:9", 200),
    *((ORIGIN, origin, 403) for origin in ("http://evil.example", "null", "")),
])  # fmt: skip
def test_only_we_are_answered(dashboard: Application, header: str, value: str, status: int) -> None:
    for path in ("/api/studies", "/dashboard", f"{PLACE}/{PICTURE}"):
        assert get(dashboard, path, **{header: value})[0] == status


def test_pictures_are_served_as_such_and_to_our_pages_alone(dashboard: Application) -> None:
    status, headers, body = get(dashboard, f"{PLACE}/{PICTURE}")
    assert (status, headers["content-type"], body) == (200, "image/png", HTML)
    assert headers["x-content-type-options"] == "nosniff"  # however it may look
    assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize("path", ["/api/studies", f"{PLACE}/{PICTURE}"])
def test_no_answer_is_for_other_pages_to_read(path: str, tmp_path: Path) -> None:
    """Whatever a version of the dashboard says of who may."""

    def generous(environment: dict[str, Any], start: Any) -> list[bytes]:
        start("200 OK", [("Access-Control-Allow-Origin", "*"), ("Content-Type", "image/png")])
        return [b"{}"]

    (tmp_path / PICTURE).write_bytes(HTML)
    status, headers, _ = get(guarded(generous, tmp_path), path)
    assert status == 200
    assert not any(name.startswith("access-control-") for name in headers)


@pytest.mark.parametrize("end", ["", "/", "//"])
@pytest.mark.parametrize(("name", "status"), [(PAGE, 403), (VECTOR, 403), (LINK, 404), (GONE, 404)])
def test_nothing_else_is_served(dashboard: Application, name: str, status: int, end: str) -> None:
    found, headers, body = get(dashboard, f"{PLACE}/{name}{end}")
    assert (found, headers["content-type"]) == (status, "text/plain; charset=utf-8")
    assert b"secret" not in body and HTML not in body


def test_without_a_folder_there_are_no_files(storage: InMemoryStorage) -> None:
    dashboard = guarded_dashboard(storage, None)
    assert get(dashboard, f"{PLACE}/{PICTURE}")[0] == 404
    assert get(dashboard, "/api/studies")[0] == 200


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


def seen(study: optuna.Study, path: str) -> Any:
    """What the dashboard's own API says."""
    status, _, body = get(guarded_dashboard(study._storage, None), path)
    assert status == 200
    return json.loads(body)


@pytest.fixture(scope="module")
def detail(study: optuna.Study) -> Any:
    return seen(study, f"/api/studies/{study._study_id}")


@pytest.mark.slow
def test_the_history_page_has_every_value(study: optuna.Study, detail: Any) -> None:
    (listed,) = seen(study, "/api/studies")["study_summaries"]
    assert (listed["study_name"], listed["directions"]) == ("throw/features", ["minimize"])
    shown = {trial["number"]: trial for trial in detail["trials"]}
    assert len(shown) == TRIALS + 2
    for trial in study.trials[:TRIALS]:
        assert shown[trial.number]["state"] == "Complete"
        assert shown[trial.number]["values"] == [trial.value]
        assert shown[trial.number]["datetime_complete"]
    assert [shown[TRIALS]["state"], shown[TRIALS + 1]["state"]] == ["Fail", "Running"]
    assert [best["number"] for best in detail["best_trials"]] == [study.best_trial.number]


@pytest.mark.slow
def test_the_parallel_page_has_all_axes_the_table_notes(study: optuna.Study, detail: Any) -> None:
    axes = {axis["name"]: axis["distribution"] for axis in detail["union_search_space"]}
    assert {name: (axis["low"], axis["high"]) for name, axis in axes.items()} == BOUNDS
    assert all(axis["type"] == "FloatDistribution" for axis in axes.values())
    for trial, shown in zip(study.trials[:TRIALS], detail["trials"][:TRIALS], strict=True):
        drawn = {param["name"]: param["param_internal_value"] for param in shown["params"]}
        assert drawn == trial.params
        assert all(BOUNDS[name][0] <= value <= BOUNDS[name][1] for name, value in drawn.items())
    sortable = {column["key"] for column in detail["union_user_attrs"] if column["sortable"]}
    assert "row" in sortable
    first = {item["key"]: item["value"] for item in detail["trials"][0]["user_attrs"]}
    assert first["row"] == str(study.trials[0].user_attrs["row"])


@pytest.mark.slow
def test_importances_are_computed_and_the_page_itself_is_served(study: optuna.Study) -> None:
    (found,) = seen(study, f"/api/studies/{study._study_id}/param_importances")["param_importances"]
    importance = {item["name"]: item["importance"] for item in found}
    assert importance["speed"] > importance["angle"]
    path = f"/dashboard/studies/{study._study_id}"
    assert b"<html" in get(guarded_dashboard(study._storage, None), path)[2].lower()
