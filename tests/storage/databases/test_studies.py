"""Study databases: how they are opened, and what is refused."""

import os
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import optuna
import pytest

from storage.databases import studies
from storage.databases.studies import only_run, open_studies, storage_errors
from taichi_nmm.errors import InputError


def test_a_database_is_made_with_its_folder_and_kept(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/deep/er/studies.db"
    study = optuna.create_study(storage=open_studies(url), study_name="a")
    study.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=2)
    assert len(optuna.load_study(storage=open_studies(url), study_name="a").trials) == 2


def test_sqlite_writes_ahead_and_waits_less(tmp_path: Path) -> None:
    storage = open_studies(f"sqlite:///{tmp_path}/studies.db")
    with storage.engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 1  # NORMAL


@pytest.mark.parametrize(
    "url", ["studies.db", "postgresql://host/db", "sqlite:///", "sqlite://", "sqlite:///a?mode=ro"]
)
def test_other_urls_are_refused(url: str) -> None:
    with pytest.raises(InputError, match=r"sqlite:///FILE or postgresql\+psycopg://"):
        open_studies(url)


@pytest.mark.parametrize(
    "url",
    ["mysql://me:secret@host/db", "postgresql://me:secret@host/db",
     "postgresql+psycopg://me:secret@host", "postgresql+psycopg://me:secret@host:port/db"],
)  # fmt: skip
def test_a_refused_url_does_not_show_its_password(url: str) -> None:
    with pytest.raises(InputError, match="storage: ") as caught:
        open_studies(url)
    assert "secret" not in str(caught.value)


def test_a_missing_driver_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(InputError, match=r"pip install 'taichi-nmm\[postgres\]'") as caught:
        open_studies("postgresql+psycopg://me:secret@host/db")
    assert "secret" not in str(caught.value) and "\n" not in str(caught.value)


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a folder"):
        open_studies(f"sqlite:///{tmp_path}")


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"storage: .*can be written"):
        open_studies(f"sqlite:///{tmp_path}/file/studies.db")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_database_is_refused(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/studies.db"
    open_studies(url).engine.dispose()
    (tmp_path / "studies.db").chmod(0o400)
    with pytest.raises(InputError, match="readonly"):
        open_studies(url)


def test_a_file_that_is_no_database_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("dear diary\n" * 100)
    with pytest.raises(InputError, match="file is not a database"):
        open_studies(f"sqlite:///{path}")
    assert path.read_text() == "dear diary\n" * 100


def test_somebody_elses_database_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "other.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE birds (name TEXT)")
    before = path.read_bytes()
    with pytest.raises(InputError, match="an Optuna database"):
        open_studies(f"sqlite:///{path}")
    assert path.read_bytes() == before


def test_a_locked_database_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(studies, "BUSY_TIMEOUT_S", 0.1)
    path = tmp_path / "studies.db"
    storage = open_studies(f"sqlite:///{path}")
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        with pytest.raises(InputError, match="database is locked") as caught:
            open_studies(f"sqlite:///{path}")
        assert "\n" not in str(caught.value)
        with (
            pytest.raises(InputError, match="database is locked") as caught,
            storage_errors(f"sqlite:///{path}"),
        ):
            optuna.create_study(storage=storage)
        assert "\n" not in str(caught.value)


def test_a_study_has_one_run_at_a_time(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/studies.db"
    with only_run(url, "rough8/dog"):
        with (
            pytest.raises(InputError, match=r"study: 'rough8/dog' .* another process"),
            only_run(url, "rough8/dog"),
        ):
            pass
        with only_run(url, "rough8/random"):
            pass
    with only_run(url, "rough8/dog"):
        pass
