"""taichi-nmm dashboard as its users run it."""

import json
import os
import shutil
import socket
import urllib.request
from pathlib import Path

import pytest

from storage.databases.bulk import FinishedStudy, attach, write_studies
from storage.databases.studies import open_studies
from tests.cases import asset
from tests.processes import serving
from tests.tools.running import ROOT, load_command

pytestmark = pytest.mark.slow

DASHBOARD = ROOT / "tools" / "dashboard.py"
PICTURE = "12345678-0000-0000-0000-000000000000"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder as an experiment leaves it: a database of two studies, one with a picture."""
    from tests.storage.databases.test_bulk import STUDY, TRIALS

    folder = tmp_path_factory.mktemp("made") / "out" / "compare" / "tiny"
    storage = open_studies(f"sqlite:///{folder}/studies.db")
    others = [
        FinishedStudy("tiny/random/run-000", TRIALS[:1]),
        FinishedStudy("tiny/summary", []),
    ]
    write_studies(storage, [STUDY, *others])
    meta = {
        "artifact_id": PICTURE,
        "filename": "a.png",
        "mimetype": "image/png",
        "encoding": None,
    }
    attach(storage, STUDY.name, 0, f"artifacts:{PICTURE}", json.dumps(meta))
    storage.engine.dispose()
    (folder / "artifacts").mkdir()
    (folder / "artifacts" / PICTURE).write_bytes(b"a picture")
    return folder


@pytest.fixture
def folder(made, tmp_path, monkeypatch):
    """A copy, and the current directory two levels above it."""
    copy = tmp_path / "out" / "compare" / "tiny"
    shutil.copytree(made, copy)
    monkeypatch.chdir(tmp_path)
    return copy


def get(address):
    with urllib.request.urlopen(address, timeout=20) as answer:
        content = answer.read()
        return content


def test_it_serves_studies_and_pictures_on_this_machine_only(folder):
    with serving(DASHBOARD, "--port", 0) as said:
        lines = dict(said.readline().split(maxsplit=1) for _ in range(4))
        address = lines["dashboard"].split()[0]
        assert address.startswith("http://127.0.0.1:") and address.endswith(
            "/dashboard"
        )
        assert lines["studies"].strip().endswith("out/compare/tiny/studies.db")
        assert lines["artifacts"].strip().endswith("out/compare/tiny/artifacts")
        server = address.removesuffix("/dashboard")
        listed = json.loads(get(f"{server}/api/studies"))["study_summaries"]
        ids = {study["study_name"]: study["study_id"] for study in listed}
        assert ids.keys() == {"e/dog/run-000", "tiny/random/run-000", "tiny/summary"}
        note = f"{address}/studies/{ids['tiny/summary']}/note"
        assert lines["summary"].split() == [note, "(tiny/summary)"]
        study = ids["e/dog/run-000"]
        trial = json.loads(get(f"{server}/api/studies/{study}"))["trials"][0]
        assert trial["artifacts"][0]["filename"] == "a.png"
        picture = f"{server}/artifacts/{study}/{trial['trial_id']}/{PICTURE}"
        assert get(picture) == b"a picture"


def test_the_newest_experiment_is_the_default_and_pictures_lie_beside_it(folder):
    command = load_command("dashboard")
    older = folder.parent / "older"
    shutil.copytree(folder, older)
    os.utime(older / "studies.db", (1.0, 1.0))
    assert command.find_database(None, None) == "sqlite:///out/compare/tiny/studies.db"
    os.utime(folder / "studies.db", (0.0, 0.0))
    assert command.find_database(None, None) == "sqlite:///out/compare/older/studies.db"
    url, postgres = (
        f"sqlite:///{folder}/studies.db",
        "postgresql+psycopg://me@host/walker",
    )
    assert command.find_database(None, url) == url
    assert command.find_database(folder, postgres) == postgres
    assert command.find_artifacts(None, url, None) == folder / "artifacts"
    assert command.find_artifacts(folder, postgres, None) == folder / "artifacts"
    assert command.find_artifacts(None, postgres, None) is None
    assert command.find_artifacts(None, postgres, folder) == folder
    shutil.rmtree(folder / "artifacts")
    assert command.find_artifacts(None, url, None) is None


@pytest.mark.parametrize(("words", "message"), asset("refused-pages.toml").items())
def test_bad_input_makes_nothing(words, message, folder, tool):
    tool.refuses(message, "dashboard", *words.replace("LONG", "x" * 300).split())
    assert sorted(path.name for path in Path().iterdir()) == ["out"]


def test_a_file_that_is_no_database_and_no_experiment_at_all(folder, tool):
    (folder / "studies.db").write_text("dear diary\n" * 100)
    tool.refuses("storage: .*file is not a database", "dashboard", folder)
    shutil.rmtree("out")
    tool.refuses("folder: .*a folder with experiments", "dashboard")


def test_a_port_in_use(folder, tool):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        tool.refuses(f"port: {port} .*a free port", "dashboard", folder, "--port", port)
