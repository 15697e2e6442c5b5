"""taichi-nmm dashboard as its users run it."""

import json
import os
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from storage.databases.bulk import FinishedStudy, attach, write_studies
from storage.databases.studies import open_studies
from tests.tools.running import load_command, run_tool

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[2]
DASHBOARD = REPOSITORY / "tools" / "dashboard.py"
PICTURE = "12345678-0000-0000-0000-000000000000"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as an experiment leaves it: a database of two studies, one with a picture."""
    from tests.storage.databases.test_bulk import STUDY, TRIALS

    folder = tmp_path_factory.mktemp("made") / "out" / "compare" / "tiny"
    storage = open_studies(f"sqlite:///{folder}/studies.db")
    others = [FinishedStudy("tiny/random/run-000", TRIALS[:1]), FinishedStudy("tiny/summary", [])]
    write_studies(storage, [STUDY, *others])
    meta = {"artifact_id": PICTURE, "filename": "a.png", "mimetype": "image/png", "encoding": None}
    attach(storage, [(STUDY.name, 0, f"artifacts:{PICTURE}", json.dumps(meta))])
    storage.engine.dispose()
    (folder / "artifacts").mkdir()
    (folder / "artifacts" / PICTURE).write_bytes(b"a picture")
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy, and the current directory two levels above it."""
    copy = tmp_path / "out" / "compare" / "tiny"
    shutil.copytree(made, copy)
    monkeypatch.chdir(tmp_path)
    return copy


@pytest.fixture
def command() -> ModuleType:
    return load_command("dashboard")


@pytest.fixture
def refuse(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    def refuse(*arguments: str) -> str:
        assert run_tool(monkeypatch, "dashboard", *arguments) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ") and said.count("\n") == 1
        return said

    return refuse


def test_it_serves_studies_and_pictures_on_this_machine_only(folder: Path) -> None:
    with subprocess.Popen(
        [sys.executable, DASHBOARD, "--port", "0"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        lines = dict(process.stdout.readline().split(maxsplit=1) for _ in range(4))
        address = lines["dashboard"].split()[0]
        try:
            assert address.startswith("http://127.0.0.1:") and address.endswith("/dashboard")
            assert lines["studies"].strip().endswith("out/compare/tiny/studies.db")
            assert lines["artifacts"].strip().endswith("out/compare/tiny/artifacts")
            server = address.removesuffix("/dashboard")
            studies = get_json(f"{server}/api/studies")["study_summaries"]
            assert {study["study_name"] for study in studies} == {
                "e/dog/run-000", "tiny/random/run-000", "tiny/summary",
            }  # fmt: skip
            summary = next(s["study_id"] for s in studies if s["study_name"] == "tiny/summary")
            assert lines["summary"].split() == [
                f"{address}/studies/{summary}/note", "(tiny/summary)",
            ]  # fmt: skip
            study = next(s["study_id"] for s in studies if s["study_name"] == "e/dog/run-000")
            trial = get_json(f"{server}/api/studies/{study}")["trials"][0]
            assert trial["artifacts"][0]["filename"] == "a.png"
            picture = f"{server}/artifacts/{study}/{trial['trial_id']}/{PICTURE}"
            assert get(picture) == b"a picture"
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0


def get(address: str) -> bytes:
    with urllib.request.urlopen(address, timeout=20) as answer:
        content: bytes = answer.read()
        return content


def get_json(address: str) -> Any:
    return json.loads(get(address))


def test_the_newest_experiment_is_the_default(folder: Path, command: ModuleType) -> None:
    older = folder.parent / "older"
    shutil.copytree(folder, older)
    os.utime(older / "studies.db", (1.0, 1.0))
    assert command.find_database(None, None) == "sqlite:///out/compare/tiny/studies.db"
    os.utime(folder / "studies.db", (0.0, 0.0))
    assert command.find_database(None, None) == "sqlite:///out/compare/older/studies.db"


def test_pictures_are_found_beside_the_database(folder: Path, command: ModuleType) -> None:
    url = f"sqlite:///{folder}/studies.db"
    postgres = "postgresql+psycopg://me@host/walker"
    assert command.find_database(None, url) == url
    assert command.find_database(folder, postgres) == postgres
    assert command.find_artifacts(None, url, None) == folder / "artifacts"
    assert command.find_artifacts(folder, postgres, None) == folder / "artifacts"
    assert command.find_artifacts(None, postgres, None) is None
    assert command.find_artifacts(None, postgres, folder) == folder


def test_an_experiment_without_pictures_is_shown(folder: Path, command: ModuleType) -> None:
    shutil.rmtree(folder / "artifacts")
    assert command.find_artifacts(None, f"sqlite:///{folder}/studies.db", None) is None


def test_what_is_not_there_is_refused_and_not_made(
    folder: Path, refuse: Callable[..., str]
) -> None:
    assert "an experiment's folder" in refuse("nowhere")
    for words in (["x" * 300], [str(folder), "--artifacts", "x" * 300]):
        assert "255 a name" in refuse(*words)
    assert "a database that is there" in refuse("--storage", "sqlite:///nowhere.db")
    assert "sqlite:///FILE or postgresql" in refuse("--storage", "nowhere.db")
    assert "a folder that is there" in refuse(str(folder), "--artifacts", "nowhere")
    assert sorted(path.name for path in Path().iterdir()) == ["out"]
    shutil.rmtree("out")
    assert "a folder with experiments" in refuse()


def test_a_file_that_is_no_database(folder: Path, refuse: Callable[..., str]) -> None:
    (folder / "studies.db").write_text("dear diary\n" * 100)
    assert "file is not a database" in refuse(str(folder))


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE version_info SET schema_version = ''",
        "UPDATE studies SET study_name = x'61' WHERE study_id = 1",
    ],
)
def test_a_damaged_database_is_refused_and_left_alone(
    folder: Path, refuse: Callable[..., str], change: str
) -> None:
    with closing(sqlite3.connect(folder / "studies.db")) as connection, connection:
        connection.execute(change)
    before = sorted(folder.iterdir())
    assert refuse("--storage", f"sqlite:///{folder}/studies.db", "--port", "0")
    assert sorted(folder.iterdir()) == before


def test_ports_that_cannot_be_had(folder: Path, refuse: Callable[..., str]) -> None:
    assert "a whole number from 0 to 65535" in refuse(str(folder), "--port", "70000")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert "a free port" in refuse(str(folder), "--port", str(port))
