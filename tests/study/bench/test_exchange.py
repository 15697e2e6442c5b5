"""Export and import keep what a trial is, and a file that comes twice is recognised."""

from dataclasses import replace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from study.bench.bench import Bench
from study.bench.exchange import export_text, read_trials
from tests.cases import cases, refused
from tests.study.bench import robot


@pytest.fixture
def file(bench, tmp_path):
    """Trials of two operators on three grounds, one of which failed, and one that is pending."""
    robot.run(bench, 2)
    bench.operator = "you"
    bench.next()
    bench.record(2, failed_s=3.0, columns={"torque": 95.0}, note="fell, on the mat")
    for context in ("gravel", "007"):
        bench.context(context)
        robot.run(bench, 1)
    bench.next()
    path = tmp_path / "trials.csv"
    path.write_text(export_text(bench))
    return path


@pytest.fixture
def again(tmp_path):
    """Another bench of the same robot."""
    (tmp_path / "second").mkdir()
    return Bench.new(robot.write(tmp_path / "second"), "somebody")


def test_all_that_a_trial_is_goes_out_and_comes_in(bench, file, again):
    def content(bench):
        own = {"number": 0, "notes": {}, "why": "", "values": []}
        return [replace(trial, **own) for trial in bench.state.finished]

    assert again.add_new(read_trials(again, file)) == ([0, 1, 2, 3, 4], [])
    assert content(again) == content(bench)
    contexts = [trial.context for trial in again.state.finished]
    assert contexts == ["", "", "", "gravel", "007"]
    line = str(again.entries[-1])
    assert "no longer" not in line and line.count("failed") == 1
    bench.context("")
    assert str(again.best()) == str(bench.best())


def test_the_same_file_twice_enters_nothing(bench, file, again):
    again.add_new(read_trials(again, file))
    again.correct(0, 0.123)  # a trial that was corrected since is the same trial
    for there in (again, bench):
        before = there.entries
        assert there.add_new(read_trials(there, file)) == ([], [0, 1, 2, 3, 4])
        assert there.entries == before
    again.undo()
    again.undo()  # the import itself: now the trials are new
    assert again.add_new(read_trials(again, file)) == ([5, 6, 7, 8, 9], [])


def test_a_list_that_has_grown_enters_what_is_new(bench, tmp_path):
    (trial,) = bench.next()
    bench.record(0, 0.9)
    row = ",".join(f"{value:.8g}" for value in trial.params.values())
    path = tmp_path / "list.csv"
    path.write_text(
        f"stiffness,damping,value,note\n{row},0.9,\n{row},0.9,again\n{row},1.1,\n"
    )
    assert bench.add_new(read_trials(bench, path)) == ([1, 2], [0])
    told = bench.state.trials
    assert [told[number].note for number in range(3)] == ["", "again", ""]
    assert told[1].params == trial.params  # typed in again as they were printed
    assert bench.best().trials == 3


@cases("bad-imports.toml", "rows", "said")
def test_what_cannot_be_imported_is_one_line(bench, tmp_path, rows, said):
    path = tmp_path / "wrong.csv"
    path.write_text("\n".join(rows.split()) + "\n")
    with refused(said):
        bench.add_new(read_trials(bench, path))
    assert len(bench.entries) == 1


def test_words_of_any_type_are_words(bench, tmp_path):
    columns = {
        "stiffness": [20.0],
        "damping": [1.0],
        "value": [2.0],
        "context": [0],
        "depth": [1],
        "note": pa.nulls(1),
        "time": pa.array([0], pa.timestamp("s")),
    }
    path = tmp_path / "trials.parquet"
    pq.write_table(pa.table(columns), path)
    with pytest.warns(UserWarning, match=r"that are no part of a trial: depth$"):
        bench.add_new(read_trials(bench, path))
    trial = bench.state.trials[0]
    assert (trial.context, trial.note) == ("0", "")
    assert trial.time == "1970-01-01 00:00:00.000"
