"""Study databases that somebody has edited: each is refused in one line, and stays as it is."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from storage.databases.studies import open_studies
from study.comparison.compare import Request, compare
from study.comparison.database import Summary
from study.experiment.arms import find_arm
from study.experiment.experiment import Experiment
from study.experiment.live_study import check_study, run_study
from study.gains import gains_of_trial
from taichi_nmm.errors import InputError


class Figure:
    """What a dashboard shows, as plotly would make it."""

    def to_json(self) -> str:
        return "{}"


@pytest.fixture
def url(toy: Experiment, tmp_path: Path) -> str:
    """Of a study of two trials."""
    url = f"sqlite:///{tmp_path}/studies.db"
    storage = open_studies(url)
    run_study(toy, find_arm("dog"), 0, 2, storage)
    storage.engine.dispose()
    return url


def edit(url: str, *commands: str) -> bytes:
    """The file after some SQL."""
    file = Path(url.removeprefix("sqlite:///"))
    with closing(sqlite3.connect(file)) as connection:
        for command in commands:
            connection.execute(command)
        connection.commit()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return file.read_bytes()


UNREADABLE = [
    "UPDATE trials SET datetime_start = '[[]]'",
    "UPDATE trials SET state = 'DONE'",
    "UPDATE trials SET number = 'a' WHERE number = 1",
    "UPDATE trial_values SET objective = 3",
    "UPDATE trial_params SET distribution_json = '{\"name\": 3}'",
    "ALTER TABLE trial_intermediate_values RENAME COLUMN step TO step_",
    "ALTER TABLE studies RENAME COLUMN study_name TO name",
    "DROP TABLE trial_heartbeats",
    "DELETE FROM studies",
    "UPDATE studies SET study_name = x'61'",
    "DELETE FROM trials WHERE number = 1",  # whose rows would be those of the next trial
]


@pytest.mark.parametrize("command", UNREADABLE)
def test_what_cannot_be_read_is_one_line(
    toy: Experiment, url: str, tmp_path: Path, command: str
) -> None:
    before = edit(url, command)
    for read in (
        lambda: check_study(toy, find_arm("dog"), 0, url, tmp_path / "out"),
        lambda: gains_of_trial("toy/dog/run-000/1", url),
    ):
        with pytest.raises(InputError, match=r"^(storage|study toy/dog/run-000).*") as caught:
            read()
        assert str(caught.value).isprintable()
    assert edit(url) == before


WRITTEN = "UPDATE trial_user_attributes SET value_json = {} WHERE key = '{}'"
UNUSABLE = {
    "DELETE FROM trial_params WHERE param_name = 'K_SOL'": "trial 0: parameters",
    "UPDATE trial_params SET param_value = 1e9 WHERE param_name = 'K_SOL'": "trial 0",
    "UPDATE trials SET number = number + 1": "trial 1",
    "UPDATE trial_params SET distribution_json = replace(distribution_json, '\"log\": false',"
    " '\"log\": null') WHERE param_name = 'K_SOL'": r"trial 0: K_SOL: 'FloatDistribution.*log=None",
    "DELETE FROM trial_user_attributes WHERE key = 'walked'": "trial 0: walked: 'missing'",
    WRITTEN.format("'[1]'", "walked"): r"trial 0: walked: \[1\]",
    WRITTEN.format("'null'", "duration_s"): "trial 0: duration_s: None",
    WRITTEN.format("'3'", "end_reason"): "trial 0: end_reason: 3",
    WRITTEN.format("'\"a\"'", "score"): "trial 0: score: 'a'",
    "UPDATE study_directions SET direction = 'MAXIMIZE'": "directions",
    "UPDATE trial_values SET value = 1e400": "trial 0: values",
    "UPDATE trial_params SET param_value = 'a' WHERE param_name = 'K_GAS'": "trial 0: K_GAS: 'a'",
}


@pytest.mark.parametrize(("command", "message"), UNUSABLE.items())
def test_what_no_study_has_written_is_named(
    toy: Experiment, url: str, tmp_path: Path, command: str, message: str
) -> None:
    before = edit(url, command)
    with pytest.raises(InputError, match=f"study toy/dog/run-000.*{message}") as caught:
        check_study(toy, find_arm("dog"), 0, url, tmp_path / "out")
    assert str(caught.value).isprintable()
    assert edit(url) == before


@pytest.mark.parametrize(
    "command",
    [
        "UPDATE study_directions SET direction = 'cuda'",
        "UPDATE trials SET datetime_start = 'never'",
        "UPDATE trial_params SET param_value = 1e9 WHERE param_name = 'K_SOL'",
        "UPDATE trial_user_attributes SET value_json = '[1]' WHERE key = 'walked'",
    ],
)
def test_a_comparisons_studies_are_looked_at_too(
    toy: Experiment, tmp_path: Path, command: str
) -> None:
    request = Request(tmp_path / "out", arms=("dog",), runs=1, trials=1, artifacts=False)
    compare(toy, request, lambda progress: None)
    url = f"sqlite:///{tmp_path}/out/studies.db"
    edit(url, "DELETE FROM study_system_attributes", command)  # notes, which are written again
    with pytest.raises(InputError, match=r"^(storage|study toy/dog/run-000)") as caught:
        compare(toy, request, lambda progress: None)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "command",
    [
        "UPDATE studies SET study_name = x'61'",
        "DELETE FROM trials WHERE number = 1",
        "DELETE FROM trial_params WHERE param_name = 'K_SOL'",
        "UPDATE trial_params SET distribution_json = '{\"name\": 3}'",
        "UPDATE trials SET datetime_start = 3",
        "UPDATE study_system_attributes SET key = CAST(key AS BLOB)",
        "UPDATE study_user_attributes SET key = CAST(key AS BLOB)",
        "UPDATE trial_user_attributes SET key = CAST(key AS BLOB)",
        "UPDATE trial_params SET param_name = CAST(param_name AS BLOB)",
    ],
)
def test_a_comparison_writes_no_table_before_its_database_is_refused(
    toy: Experiment, tmp_path: Path, command: str
) -> None:
    request = Request(tmp_path / "out", arms=("dog",), runs=1, trials=2, artifacts=False)
    compare(toy, request, lambda progress: None)
    url = f"sqlite:///{tmp_path}/out/studies.db"
    (tmp_path / "out" / "trials.parquet").unlink()
    before = edit(url, command)
    with pytest.raises(InputError, match=r"^(storage|study toy/dog/run-000)"):
        compare(toy, request, lambda progress: None)
    assert not (tmp_path / "out" / "trials.parquet").exists()
    assert edit(url) == before


def test_a_name_too_long_for_a_lock_is_refused_before_the_database_is_made(
    toy: Experiment, tmp_path: Path
) -> None:
    long = replace(toy, name="x" * 240)
    with pytest.raises(InputError, match=r"^storage: .*File name too long"):
        check_study(long, find_arm("dog"), 0, f"sqlite:///{tmp_path}/new.db", tmp_path / "out")
    assert not list(tmp_path.glob("new.db*"))


NOTE = "UPDATE study_system_attributes SET {} WHERE key LIKE 'dashboard:note_{}'"


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (NOTE.format("value_json = '[[]]'", "str:%"), r"\[\[\]\]"),
        (NOTE.format("value_json = '\"/\"'", "ver"), "'/'"),
        (NOTE.format("key = 'dashboard:note_str:7'", "str:0"), r"\[7\]"),
    ],
)
def test_a_damaged_note_is_one_line(
    toy: Experiment, url: str, tmp_path: Path, command: str, message: str
) -> None:
    before = edit(url, command)
    with pytest.raises(InputError, match=f"study toy/dog/run-000: note: {message}"):
        check_study(toy, find_arm("dog"), 0, url, tmp_path / "out")
    assert edit(url) == before


@pytest.mark.parametrize(
    "command",
    [
        "UPDATE study_directions SET direction = 'cuda'",
        "UPDATE study_system_attributes SET value_json = '\"a'",
        "UPDATE study_user_attributes SET value_json = '\"a' WHERE key <> 'experiment_config'",
        NOTE.format("value_json = 'null'", "ver"),
    ],
)
def test_a_summary_that_cannot_be_read_is_refused_before_the_work(
    toy: Experiment, tmp_path: Path, command: str
) -> None:
    def run() -> None:
        compare(toy, request, lambda progress: None, summarise=lambda *_: Summary("", Figure()))

    request = Request(tmp_path / "out", arms=("random",), runs=1, trials=1, artifacts=False)
    run()
    (tmp_path / "out" / "trials.parquet").unlink()
    url = f"sqlite:///{tmp_path}/out/studies.db"
    before = edit(url, command)
    with pytest.raises(InputError, match=r"^(storage|study toy/summary: note): "):
        run()
    assert not (tmp_path / "out" / "trials.parquet").exists()
    assert edit(url) == before


def test_a_file_with_a_damaged_page_is_refused_before_the_work(
    toy: Experiment, tmp_path: Path
) -> None:
    request = Request(tmp_path / "out", arms=("random",), runs=1, trials=1, artifacts=False)
    compare(toy, request, lambda progress: None)
    (tmp_path / "out" / "trials.parquet").unlink()
    file = tmp_path / "out" / "studies.db"
    edit(f"sqlite:///{file}")
    content = bytearray(file.read_bytes())
    content[-4096:] = b"\xff" * 4096  # SQLite's page
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"^storage: .*SQLite finds whole") as caught:
        compare(toy, request, lambda progress: None)
    assert str(caught.value).isprintable()
    assert not (tmp_path / "out" / "trials.parquet").exists()
    assert file.read_bytes() == content


def test_a_schema_that_is_no_text_is_one_line(toy: Experiment, url: str, tmp_path: Path) -> None:
    file = Path(url.removeprefix("sqlite:///"))
    content = edit(url).replace(b"CREATE TABLE trials", b"CREATE \xc5ABLE trials")
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"(?i)^storage: .*utf-8") as caught:
        check_study(toy, find_arm("dog"), 0, url, tmp_path / "out")
    assert str(caught.value).isprintable()
    assert file.read_bytes() == content
