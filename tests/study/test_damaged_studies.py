"""Study databases that somebody has edited: each is refused in one line, and stays as it is."""

import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

import taichi_nmm
from storage.databases.studies import open_studies
from study.experiment.arms import find_arm
from study.experiment.compare import Request, compare
from study.experiment.gains import gains_of_trial
from study.experiment.live_study import check_study, run_study
from tests.cases import cases, refused
from tests.study import fake_walker

OF_DOG = r"^(storage|study toy/dog/run-000)"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a live study of two trials, and two finished comparisons by their arms."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
        toy, url = fake_walker.experiment(folder), f"sqlite:///{folder}/studies.db"
        storage = open_studies(url)
        run_study(toy, find_arm("dog"), 0, 2, storage)
        storage.engine.dispose()
        edit(url)
        for arm in ("dog", "random"):
            compared(toy, folder / arm, arm)
            edit(f"sqlite:///{folder}/{arm}/studies.db")
    return folder


@pytest.fixture
def url(made, tmp_path):
    """Of a copy of the study."""
    return f"sqlite:///{shutil.copy(made / 'studies.db', tmp_path)}"


@pytest.fixture
def check(toy, url, tmp_path):
    """What a command looks at before it goes on with this study."""
    return lambda: check_study(toy, find_arm("dog"), 0, url, tmp_path / "out")


def edit(url, *commands):
    """The file after some SQL."""
    file = Path(url.removeprefix("sqlite:///"))
    with closing(sqlite3.connect(file)) as connection:
        for command in commands:
            connection.execute(command)
        connection.commit()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return file.read_bytes()


@cases("unreadable-studies.toml", "command")
def test_what_cannot_be_read_is_one_line(url, check, command):
    before = edit(url, command)
    for read in (check, lambda: gains_of_trial("toy/dog/run-000/1", url)):
        with refused(OF_DOG):
            read()
    assert edit(url) == before


@cases("unwritten-studies.toml", "command", "message")
def test_unwritten_parts(url, check, command, message):
    before = edit(url, command)
    with refused(f"study toy/dog/run-000{message}"):
        check()
    assert edit(url) == before


def test_a_schema_that_is_no_text_is_one_line(url, check):
    file = Path(url.removeprefix("sqlite:///"))
    content = edit(url).replace(b"CREATE TABLE trials", b"CREATE \xc5ABLE trials")
    file.write_bytes(content)
    with refused(r"(?i)^storage: .*utf-8"):
        check()
    assert file.read_bytes() == content


def test_a_name_too_long_for_a_lock_is_refused_at_once(toy, tmp_path):
    long = replace(toy, name="x" * 240)
    with refused(r"^storage: .*File name too long"):
        check_study(
            long, find_arm("dog"), 0, f"sqlite:///{tmp_path}/new.db", tmp_path / "out"
        )
    assert not list(tmp_path.glob("new.db*"))


# Databases of comparisons.


def compared(toy, out, arm):
    request = Request(out, arms=(arm,), runs=1, trials=2)
    compare(toy, request, lambda progress: None, summarise=lambda *_: "")


@pytest.fixture
def refuses_before_it_works(toy, made, tmp_path):
    """A finished comparison whose table is gone, and whose database is damaged, writes nothing."""

    def refuses(arm, damage, message):
        out = Path(shutil.copytree(made / arm, tmp_path / "out"))
        (out / "trials.parquet").unlink()
        before = damage(f"sqlite:///{out}/studies.db")
        with refused(message):
            compared(toy, out, arm)
        assert not (out / "trials.parquet").exists()
        assert (out / "studies.db").read_bytes() == before

    return refuses


OF_SUMMARY = r"^(storage|study toy/summary: note): "


@cases("damaged-comparisons.toml", "arm", "command")
def test_no_table_after_a_refusal(refuses_before_it_works, arm, command):
    message = {"dog": OF_DOG, "random": OF_SUMMARY}[arm]
    refuses_before_it_works(arm, lambda url: edit(url, command), message)


def test_a_damaged_page_is_refused_before_the_work(
    refuses_before_it_works,
):
    def damage(url):
        content = edit(url)[:-4096] + b"\xff" * 4096  # SQLite's page
        Path(url.removeprefix("sqlite:///")).write_bytes(content)
        return content

    refuses_before_it_works("random", damage, "^storage: .*SQLite finds whole")
