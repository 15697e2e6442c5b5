"""The dashboard's answers: to whom, and which files."""

import io
import json
from wsgiref.util import setup_testing_defaults
from wsgiref.validate import validator

import optuna
import pytest
from optuna.storages import InMemoryStorage

from study.commands.dashboard import guarded_dashboard
from study.loopback import guarded
from tests.cases import asset


def get(application, path, **changes):
    """Status, headers by lower-case name, and body; changes are of the environment."""
    environment = {
        "PATH_INFO": path,
        "SCRIPT_NAME": "",
        "QUERY_STRING": "",
    }
    environment |= {
        "HTTP_HOST": "127.0.0.1:8080",
        "wsgi.errors": io.StringIO(),
        **changes,
    }
    setup_testing_defaults(environment)
    found = []
    answer = validator(application)(environment, lambda *given: found.append(given[:2]))
    body = b"".join(answer)
    answer.close()
    ((status, headers),) = found
    return int(status[:3]), {name.lower(): value for name, value in headers}, body


HTML = b"<script>alert(1)</script>"
PICTURE, PAGE, LINK, GONE, VECTOR = (f"{number:08d}-0000" for number in range(1, 6))
TYPES = {
    PICTURE: "image/png",
    PAGE: "text/html",
    LINK: "image/png",
    GONE: "image/png",
    VECTOR: "image/svg+xml",
}
PLACE = "/artifacts/0/0"  # of the files of the one trial


@pytest.fixture
def storage():
    """Of a study whose database names files of a folder."""
    storage = InMemoryStorage()
    trial = optuna.create_study(storage=storage, study_name="a").ask()
    for name, kind in TYPES.items():
        meta = {
            "artifact_id": name,
            "filename": "a",
            "mimetype": kind,
            "encoding": None,
        }
        storage.set_trial_system_attr(
            trial._trial_id, f"artifacts:{name}", json.dumps(meta)
        )
    return storage


@pytest.fixture
def dashboard(storage, tmp_path):
    artifacts = tmp_path / "artifacts"
    artifacts.mkdir()
    for name in (PICTURE, PAGE, VECTOR):
        (artifacts / name).write_bytes(HTML)
    (tmp_path / "secret").write_bytes(b"secret")
    (artifacts / LINK).symlink_to(tmp_path / "secret")
    return guarded_dashboard(storage, artifacts)


@pytest.mark.parametrize(
    ("header", "value", "status"),
    [
        (header, value, int(status))
        for header, answers in asset("callers.toml").items()
        for status, values in answers.items()
        for value in values
    ],
)
def test_only_we_are_answered(dashboard, header, value, status):
    for path in ("/api/studies", "/dashboard", f"{PLACE}/{PICTURE}"):
        assert get(dashboard, path, **{header: value})[0] == status


def test_pictures_are_served_as_such_and_to_our_pages_alone(
    dashboard,
):
    status, headers, body = get(dashboard, f"{PLACE}/{PICTURE}")
    assert (status, headers["content-type"], body) == (200, "image/png", HTML)
    assert headers["x-content-type-options"] == "nosniff"  # however it may look
    assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize("path", ["/api/studies", f"{PLACE}/{PICTURE}"])
def test_no_answer_is_for_other_pages_to_read(path, tmp_path):
    """Whatever a version of the dashboard says of who may."""

    def generous(environment, start):
        start(
            "200 OK",
            [("Access-Control-Allow-Origin", "*"), ("Content-Type", "image/png")],
        )
        return [b"{}"]

    (tmp_path / PICTURE).write_bytes(HTML)
    status, headers, _ = get(guarded(generous, tmp_path), path)
    assert status == 200
    assert not any(name.startswith("access-control-") for name in headers)


@pytest.mark.parametrize("end", ["", "/", "//"])
@pytest.mark.parametrize(
    ("name", "status"), [(PAGE, 403), (VECTOR, 403), (LINK, 404), (GONE, 404)]
)
def test_nothing_else_is_served(dashboard, name, status, end):
    found, headers, body = get(dashboard, f"{PLACE}/{name}{end}")
    assert (found, headers["content-type"]) == (status, "text/plain; charset=utf-8")
    assert b"secret" not in body and HTML not in body


def test_without_a_folder_there_are_no_files(storage):
    dashboard = guarded_dashboard(storage, None)
    assert get(dashboard, f"{PLACE}/{PICTURE}")[0] == 404
    assert get(dashboard, "/api/studies")[0] == 200
