"""Several processes on one study of a PostgreSQL server, or at one new SQLite file."""

import signal
from collections import Counter

import optuna
import pytest
import sqlalchemy as sql
from optuna.trial import TrialState

from storage.databases.postgresql import Crew
from storage.databases.studies import only_run, open_studies
from tests.cases import refused
from tests.processes import until
from tests.study import fake_walker
from tests.tools.running import WAIT_S, finish, start

pytestmark = pytest.mark.slow

TRIALS = 30

OPEN = """
import sys, time
from pathlib import Path
from storage.databases.studies import open_studies

for number in range(5):
    Path(sys.argv[1], f"{sys.argv[2]}-{number}").touch()
    deadline_s = time.monotonic() + 30.0
    while len(list(Path(sys.argv[1]).glob(f"?-{number}"))) < 4:
        assert time.monotonic() < deadline_s
        time.sleep(0.001)
    open_studies(f"sqlite:///{sys.argv[1]}/{number}.db")
"""


def test_four_processes_of_which_one_is_killed(url, tmp_path):
    fake_walker.write_plain_store(tmp_path / "store")
    words = ["--config", "rough8", "--arm", "dog", "--trials", TRIALS, "--storage", url]
    words += ["--store", tmp_path / "store"]
    processes = [
        start("study", *words, "--out", tmp_path / str(n), trial_s=0.1)
        for n in range(4)
    ]
    finished = "SELECT count(*) FROM trials WHERE state = 'COMPLETE'"
    with open_studies(url).engine.connect() as connection:
        connection.execution_options(isolation_level="AUTOCOMMIT")
        until(lambda: connection.execute(sql.text(finished)).scalar_one() >= 10, WAIT_S)
    processes[0].send_signal(signal.SIGKILL)
    done = [finish(process) for process in processes]
    assert [each.code for each in done] == [-9, 0, 0, 0], done
    said = [each.out + each.error for each in done]
    assert all("rough8/dog/run-000" in lines for lines in said)  # each had trials
    assert all("://***@" in lines for lines in said[1:]) and "secret" not in "".join(
        said
    )
    study = optuna.load_study(
        study_name="rough8/dog/run-000", storage=open_studies(url)
    )
    states = Counter(trial.state for trial in study.trials)
    assert states[TrialState.COMPLETE] == TRIALS
    assert (
        states.keys() <= {TrialState.COMPLETE, TrialState.FAIL}
        and states[TrialState.FAIL] <= 1
    )
    rows = [t.user_attrs["row"] for t in study.trials if t.state is TrialState.COMPLETE]
    assert len(set(rows)) == TRIALS
    lost = [
        t.params
        for t in study.trials
        if t.state is TrialState.FAIL and len(t.params) == 16
    ]
    done = [t.params for t in study.trials if t.state is TrialState.COMPLETE]
    assert all(params in done for params in lost)  # run again


def test_a_new_file_is_opened_by_four_processes_at_once(tmp_path):
    processes = [start(tmp_path, number, program=("-c", OPEN)) for number in range(4)]
    done = [finish(process) for process in processes]
    assert [each.code for each in done] == [0] * 4, done
    assert len(list(tmp_path.glob("?.db"))) == 5
    for file in tmp_path.glob("?.db"):
        optuna.create_study(storage=open_studies(f"sqlite:///{file}"), study_name="a")


def test_a_trial_whose_process_is_gone_is_dead(server, url):
    """Its lock is of this study, in this database, and ends with the connection."""
    storage = open_studies(url)
    study = optuna.create_study(storage=storage, study_name="a")
    other = optuna.create_study(storage=storage, study_name="b")
    number = study.ask().number
    study.tell(study.ask(), 1.0)
    other.ask()
    with Crew.joined(url, "a") as mine:
        assert mine.dead() == [number]
        for another in (Crew.joined(url, "b"), Crew.joined(server.new_database(), "a")):
            with another as crew, crew.alive(number):
                assert mine.dead() == [number]
        with mine.alive(number):
            assert mine.dead() == []
            with Crew.joined(url, "a") as theirs, theirs.turn():
                assert theirs.dead() == []
        assert mine.dead() == [number]
        with Crew.joined(url, "a") as theirs, theirs.alive(number):
            assert mine.dead() == []
            theirs._connection.invalidate()
            until(lambda: mine.dead() == [number])


def test_a_study_is_for_one_process_or_for_a_crew(url):
    error = refused(r"^study: 'a' .* one is running this one")
    with only_run(url, "a"), Crew.joined(url, "b"), error, Crew.joined(url, "a"):
        pass
    other = refused(r"^study: 'a' .* another process")
    with Crew.joined(url, "a"), other, only_run(url, "a"):
        pass
