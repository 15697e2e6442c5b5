"""Whom the dashboard answers, and what files it serves."""

import io
import json
from pathlib import Path
from typing import Any
from wsgiref.util import setup_testing_defaults
from wsgiref.validate import validator

import optuna
import pytest
from optuna.storages import InMemoryStorage

from study.commands.dashboard import guarded_dashboard
from study.loopback import guarded

HTML = b"<script>alert(1)</script>"
PICTURE, PAGE, LINK, GONE, VECTOR = (f"{number:08d}-0000" for number in range(1, 6))
TYPES = {PICTURE: "image/png", PAGE: "text/html", LINK: "image/png", GONE: "image/png",
         VECTOR: "image/svg+xml"}  # fmt: skip


class Dashboard:
    """A study whose database names files of a folder, and requests without a socket."""

    def __init__(self, folder: Path) -> None:
        self.storage = InMemoryStorage()
        study = optuna.create_study(storage=self.storage, study_name="a")
        trial = study.ask()
        for name, kind in TYPES.items():
            meta = {"artifact_id": name, "filename": "a", "mimetype": kind, "encoding": None}
            self.storage.set_trial_system_attr(
                trial._trial_id, f"artifacts:{name}", json.dumps(meta)
            )
        self.artifacts = artifacts = folder / "artifacts"
        artifacts.mkdir()
        for name in (PICTURE, PAGE, VECTOR):
            (artifacts / name).write_bytes(HTML)
        (folder / "secret").write_bytes(b"secret")
        (artifacts / LINK).symlink_to(folder / "secret")
        self.place = f"/artifacts/{study._study_id}/{trial._trial_id}"
        self.application = validator(guarded_dashboard(self.storage, artifacts))

    def get(self, path: str, **changes: str) -> tuple[int, dict[str, str], bytes]:
        """Status, headers by lower-case name, and body; changes are of the environment."""
        environment: dict[str, Any] = {"PATH_INFO": path, "SCRIPT_NAME": "", "QUERY_STRING": ""}
        environment |= {"HTTP_HOST": "127.0.0.1:8080", "wsgi.errors": io.StringIO(), **changes}
        setup_testing_defaults(environment)
        found: list[tuple[str, list[tuple[str, str]]]] = []
        answer = self.application(environment, lambda *given: found.append(given[:2]))
        body = b"".join(answer)
        answer.close()  # type: ignore[attr-defined]
        ((status, headers),) = found
        return int(status[:3]), {name.lower(): value for name, value in headers}, body


@pytest.fixture
def dashboard(tmp_path: Path) -> Dashboard:
    return Dashboard(tmp_path)


@pytest.mark.parametrize(
    ("host", "status"),
    [("127.0.0.1:8080", 200), ("localhost", 200), ("LOCALHOST:1", 200), ("[::1]:8080", 200),
     ("evil.example", 403), ("evil.example:8080", 403), ("127.0.0.1.evil.example", 403),
     ("localhost.evil.example:8080", 403), ("localhost@evil.example", 403), ("", 403)],
)  # fmt: skip
def test_only_loopback_names_are_answered(dashboard: Dashboard, host: str, status: int) -> None:
    for path in ("/api/studies", "/dashboard", f"{dashboard.place}/{PICTURE}"):
        assert dashboard.get(path, HTTP_HOST=host)[0] == status


@pytest.mark.parametrize(
    ("origin", "status"),
    [("http://127.0.0.1:8080", 200), ("http://localhost:9", 200), ("http://evil.example", 403),
     ("null", 403), ("", 403)],
)  # fmt: skip
def test_no_other_pages_requests_are_answered(
    dashboard: Dashboard, origin: str, status: int
) -> None:
    assert dashboard.get("/api/studies", HTTP_ORIGIN=origin)[0] == status


def test_pictures_are_served_as_such_and_to_our_pages_alone(dashboard: Dashboard) -> None:
    status, headers, body = dashboard.get(f"{dashboard.place}/{PICTURE}")
    assert (status, headers["content-type"], body) == (200, "image/png", HTML)
    assert headers["x-content-type-options"] == "nosniff"  # however it may look
    assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize("path", ["/api/studies", f"/artifacts/1/1/{PICTURE}"])
def test_no_answer_is_for_other_pages_to_read(dashboard: Dashboard, path: str) -> None:
    """Whatever a version of the dashboard says of who may."""

    def generous(environment: dict[str, Any], start: Any) -> list[bytes]:
        headers = [("Access-Control-Allow-Origin", "*"), ("Content-Type", "image/png")]
        start("200 OK", headers)
        return [b"{}"]

    dashboard.application = validator(guarded(generous, dashboard.artifacts))
    status, headers, _ = dashboard.get(path)
    assert status == 200
    assert not any(name.startswith("access-control-") for name in headers)


@pytest.mark.parametrize(("name", "status"), [(PAGE, 403), (VECTOR, 403), (LINK, 404), (GONE, 404)])
def test_nothing_else_is_served(dashboard: Dashboard, name: str, status: int) -> None:
    for end in ("", "/", "//"):
        found, headers, body = dashboard.get(f"{dashboard.place}/{name}{end}")
        assert (found, headers["content-type"]) == (status, "text/plain; charset=utf-8")
        assert b"secret" not in body and HTML not in body


def test_without_a_folder_there_are_no_files(dashboard: Dashboard) -> None:
    dashboard.application = validator(guarded_dashboard(dashboard.storage, None))
    assert dashboard.get(f"{dashboard.place}/{PICTURE}")[0] == 404
    assert dashboard.get("/api/studies")[0] == 200
