"""Study databases: how they are opened, and what is refused."""

import errno
import fcntl
import os
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import optuna
import pytest
from optuna.exceptions import StorageInternalError
from optuna.storages import RDBStorage

from storage.databases import studies
from storage.databases.bulk import study_attributes
from storage.databases.studies import (
    only_run,
    open_studies,
    read_studies,
    storage_errors,
)
from storage.databases.urls import file_url
from tests.cases import asset, refused
from tests.storage.fake import content


def test_a_database_is_made_with_its_folder_and_kept(tmp_path):
    url = f"sqlite:///{tmp_path}/deep/er/studies.db"
    study = optuna.create_study(storage=open_studies(url), study_name="a")
    study.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=2)
    assert len(optuna.load_study(storage=open_studies(url), study_name="a").trials) == 2
    with open_studies(url).engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 1  # NORMAL


@pytest.mark.parametrize(
    ("url", "match"),
    [
        (url, match)
        for match, urls in asset("refused-urls.toml").items()
        for url in urls
    ],
)
def test_other_urls_are_refused_without_their_passwords(url, match):
    with refused(match) as caught:
        open_studies(url)
    text = str(caught.value)
    assert text.startswith("storage: ") and "secret" not in text


@pytest.mark.parametrize(("url", "shown"), asset("shown-urls.toml").items())
def test_what_of_a_url_is_shown(url, shown):
    assert studies.public_url(url) == shown


def test_a_missing_driver_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with refused(r"pip install 'taichi-nmm\[postgres\]'") as caught:
        open_studies("postgresql+psycopg://me:secret@host/db")
    assert "secret" not in str(caught.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_database_is_refused(tmp_path):
    url = f"sqlite:///{tmp_path}/studies.db"
    open_studies(url).engine.dispose()
    (tmp_path / "studies.db").chmod(0o400)
    with refused("readonly"):
        open_studies(url)


def test_no_database_is_kept_and_a_link_to_itself_is_refused(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("dear diary\n" * 100)
    with refused("file is not a database"):
        open_studies(f"sqlite:///{path}")
    assert path.read_text() == "dear diary\n" * 100
    (tmp_path / "studies.db").symlink_to("studies.db")
    reading = read_studies(f"sqlite:///{tmp_path}/studies.db")
    with refused("storage: "), reading:
        pass


OTHERS, CHANGES = asset("foreign-databases.toml").values()


@pytest.mark.parametrize("mode", ["DELETE", "WAL"])
@pytest.mark.parametrize("kind", [*OTHERS, *CHANGES])
def test_a_refused_database_is_kept_as_it_is(tmp_path, kind, mode):
    path = tmp_path / "other.db"
    if kind in CHANGES:
        storage = RDBStorage(f"sqlite:///{path}")
        optuna.create_study(storage=storage, study_name="mine")
        storage.engine.dispose()
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        for statement in (*OTHERS.get(kind, ()), *CHANGES.get(kind, ())):
            connection.execute(statement)
        connection.execute(f"PRAGMA journal_mode={mode}")
    before = content(tmp_path)
    assert list(before) == ["other.db"]
    with refused(r"an Optuna database|no longer compatible"):
        open_studies(f"sqlite:///{path}")
    assert content(tmp_path) == before


@pytest.mark.parametrize("kind", ["no revision", "no version", "no table of revisions"])
def test_a_database_that_was_being_made_is_finished(tmp_path, kind):
    url = f"sqlite:///{tmp_path}/studies.db"
    RDBStorage(url).engine.dispose()
    with closing(
        sqlite3.connect(tmp_path / "studies.db", isolation_level=None)
    ) as connection:
        connection.execute(*CHANGES[kind])
    with read_studies(url) as nothing:
        assert nothing is None
    optuna.create_study(storage=open_studies(url), study_name="a")


def test_a_new_database_appears_whole(tmp_path, monkeypatch):
    url = f"sqlite:///{tmp_path}/studies.db"

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(os, "link", killed)
        open_studies(url)
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(os, "link", lambda *_: Path("nowhere").stat())  # no links here
    optuna.create_study(storage=open_studies(url), study_name="a")
    assert "studies.db" in content(tmp_path)
    monkeypatch.undo()
    file = tmp_path / "studies.db"
    os.link(file, tmp_path / ".studies.db.1.tmp")
    open_studies(f"sqlite:///{file}").engine.dispose()
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".tmp"] == []


def test_what_is_read_is_not_written(tmp_path):
    """Also beside a log that another process left, and of a name that URLs would quote."""
    url = file_url(tmp_path / "a b{1}#%20?.db")
    with read_studies(url) as nothing:
        assert nothing is None
    assert not list(tmp_path.iterdir())
    optuna.create_study(storage=open_studies(url), study_name="a")
    assert "a b{1}#%20?.db" in content(tmp_path)
    with read_studies(url) as storage:
        assert optuna.get_all_study_names(storage) == ["a"]
        with pytest.raises(StorageInternalError):
            optuna.create_study(storage=storage, study_name="b")
    with closing(sqlite3.connect(tmp_path / "empty.db")) as connection:
        connection.execute("PRAGMA user_version=1")
    with read_studies(f"sqlite:///{tmp_path}/empty.db") as nothing:
        assert nothing is None


@pytest.mark.parametrize("name", ["x" * 300, "file/studies.db"])
def test_places_where_no_file_can_be(tmp_path, name):
    (tmp_path / "file").touch()
    with refused(r"storage: .*a place that can be written"):
        open_studies(f"sqlite:///{tmp_path}/{name}")
    with refused("not a folder"):
        open_studies(f"sqlite:///{tmp_path}")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_values_that_are_not_json_are_one_line(tmp_path):
    url = f"sqlite:///{tmp_path}/studies.db"
    study = optuna.create_study(storage=open_studies(url), study_name="a")
    study.set_user_attr("key", 1)
    with closing(sqlite3.connect(tmp_path / "studies.db")) as connection, connection:
        connection.execute("UPDATE study_user_attributes SET value_json = '{'")
    storage = open_studies(url)
    with (
        refused(r"storage: .*studies\.db"),
        storage_errors(url),
    ):
        assert optuna.load_study(study_name="a", storage=storage).user_attrs
    with refused("storage: "), read_studies(url) as looked:
        assert looked is not None and study_attributes(looked, "key")


def test_a_locked_database_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(studies, "BUSY_TIMEOUT_S", 0.1)
    path = tmp_path / "studies.db"
    storage = open_studies(f"sqlite:///{path}")
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        with refused("database is locked"):
            open_studies(f"sqlite:///{path}")
        error = refused("database is locked")
        with error, storage_errors(f"sqlite:///{path}"):
            optuna.create_study(storage=storage)


def test_a_study_has_one_run_at_a_time(any_url):
    error = refused(r"study: 'rough8/dog' .* another process")
    with only_run(any_url, "rough8/dog"):
        with error, only_run(any_url, "rough8/dog"):
            pass
        with only_run(any_url, "rough8/random"):
            pass
    with only_run(any_url, "rough8/dog"):
        pass


def test_one_run_under_any_name_of_a_file(tmp_path, monkeypatch):
    """Two runs would take each other's running trials for dead."""
    file, link = tmp_path / "studies.db", tmp_path / "elsewhere" / "link.db"
    link.parent.mkdir()
    link.symlink_to(file)
    error = refused(r"study: 'rough8/dog' .* another process")
    ours = only_run(f"sqlite:///{file}", "rough8/dog")
    with ours, error, only_run(f"sqlite:///{link}", "rough8/dog"):
        pass
    file.touch()
    (link.parent / "hard.db").hardlink_to(file)
    allowed = r"storage: .* a file with one name; this has 2 hard links"
    url = f"sqlite:///{link.parent}/hard.db"
    with refused(allowed), only_run(url, "rough8/dog"):
        pass

    def fails(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", fails)
    url, allowed = (
        f"sqlite:///{tmp_path}/other.db",
        r"storage: .* file system with locks",
    )
    with refused(allowed), only_run(url, "rough8/dog"):
        pass


def test_what_another_program_deletes_or_tells_is_one_line(tmp_path):
    url = f"sqlite:///{tmp_path}/studies.db"
    study = optuna.create_study(storage=open_studies(url), study_name="taken")
    trial = study.ask()
    optuna.delete_study(study_name="taken", storage=RDBStorage(url))
    with (
        refused(r"storage: .* deleted this one"),
        storage_errors(url),
    ):
        study.tell(trial, 1.0)
    with pytest.raises(KeyError, match="ours"), storage_errors(url):
        raise KeyError("ours")
    study = optuna.create_study(storage=open_studies(url), study_name="told")
    trial = study.ask()
    optuna.load_study(storage=RDBStorage(url), study_name="told").tell(
        trial.number, 1.0
    )
    with (
        refused(r"storage: .* told a running"),
        storage_errors(url),
    ):
        trial.set_user_attr("walked", True)


@pytest.mark.parametrize("replaced", [False, True])
def test_a_database_that_is_removed_is_not_written_any_more(tmp_path, replaced):
    """SQLite would go on without an error, and nothing would be kept."""
    file = tmp_path / "studies.db"
    study = optuna.create_study(storage=open_studies(f"sqlite:///{file}"))
    study.tell(study.ask(), 1.0)
    file.unlink()
    if replaced:
        open_studies(f"sqlite:///{tmp_path}/other.db").engine.dispose()
        (tmp_path / "other.db").rename(file)
    with refused(r"storage: .* no trial since then is kept"):
        study.ask()
