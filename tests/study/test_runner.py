"""Live studies from first trial to last: what they record, that interruptions leave no
trace, and that they are the studies of a comparison."""

import json
import pickle
import shlex
import sqlite3
from contextlib import closing, nullcontext
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import optuna
import pytest
from optuna.storages import InMemoryStorage
from optuna.trial import TrialState

import taichi_nmm
from storage.databases.studies import open_studies
from study.commands.study import dashboard_command, film_command
from study.experiment import live_study
from study.experiment.arms import find_arm
from study.experiment.compare import Request, compare
from study.experiment.experiment import study_name
from study.experiment.live_study import open_study, run_study
from study.experiment.objective import Objective
from study.experiment.one_study import OneStudy
from study.experiment.samplers import Task
from study.experiment.walker import ATTRIBUTES
from study.options import config_path
from taichi_nmm.terrain import Ground
from tests.cases import refused
from tests.study import fake_walker

LIVE = ("dog", "cmaes-cold", "cmaes-warm", "worlds", "random", "tpe")
# Each kind of sampler with a memory.
RESUMED = ("dog", "cmaes-cold", "cmaes-warm", "tpe")
TRIALS = 16  # beyond a generation of 12


def run(
    experiment,
    arm,
    trials,
    storage=None,
    number=0,
):
    """The finished trials of a study that is run until it has so many; None: in memory."""
    storage = storage or InMemoryStorage()
    study = run_study(experiment, find_arm(arm), number, trials, storage)
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def facts(trials):
    """All that a trial says but its number and its times."""
    return [(trial.params, trial.value, trial.user_attrs) for trial in trials]


def interrupted(
    experiment,
    arm,
    storage,
    error,
):
    """Run 1, stopped in trials 1, 5, 6, and 14 of which some were repeated before."""
    for call in (1, 5, 1, 9):
        stopped = fake_walker.stopped_in_call(call, error)
        with mock.patch.dict(vars(taichi_nmm), simulate=stopped), pytest.raises(error):
            run(experiment, arm, TRIALS, storage, 1)


def test_the_cost_is_that_of_the_run_and_the_configured_one(
    toy,
):
    costs = {"smooth": taichi_nmm.smooth_cost, "walking": taichi_nmm.walking_cost}
    for cost, function in costs.items():
        experiment = replace(toy, objective=Objective(cost))
        (trial,) = run(experiment, "random", 1, number=2)
        gains = fake_walker.gain_rows(list(trial.params.values()))
        other, own = (function(experiment.simulate([run], gains))[0] for run in (1, 2))
        assert trial.value == own != other


def test_a_study_says_what_its_objective_is_called(toy):
    """One of before gets the name when it goes on; a name of the user's stays."""
    storage, name = InMemoryStorage(), study_name("toy", "random", 0)
    optuna.create_study(storage=storage, study_name=name)
    for metric in ("smooth_cost", "mine"):
        run(toy, "random", 1, storage)
        study = optuna.load_study(study_name=name, storage=storage)
        assert study.metric_names == [metric]
        study.set_metric_names(["mine"])


def assert_same(trials, frame, arm, names):
    """The trials of a study are run 1 of the table, to the bit."""
    rows = frame[(frame.arm == arm) & (frame.run == 1)].to_dict("records")
    assert len(trials) == len(rows)
    for trial, row in zip(trials, rows, strict=True):
        assert trial.params == {name: row[name] for name in names}
        assert tuple(trial.params) == names
        assert trial.value == row["cost"]
        assert trial.user_attrs.get("row", -1) == row["row"]
        for name in ATTRIBUTES:
            assert trial.user_attrs[name] == row[name]


@pytest.mark.slow
def test_live_study_as_compared(comparisons):
    """Also when it is run in pieces, and stopped in the middle by Ctrl-C or the simulator."""
    toy = comparisons.experiment
    comparisons.run("compared", arms=RESUMED, runs=2, trials=TRIALS)
    frame = comparisons.table("compared").to_pandas()
    database = open_studies(f"sqlite:///{comparisons.folder}/studies.db")
    pieces = open_studies(f"sqlite:///{comparisons.folder}/pieces.db")
    for arm in RESUMED:
        for trials in (1, 4, 13, TRIALS, 3):  # the last: a finished study is left alone
            found = run(toy, arm, trials, pieces, 1)
            assert len(found) == (TRIALS if trials == 3 else trials)
        assert_same(found, frame, arm, toy.names)
        name = study_name("toy", arm, 1)
        memory = InMemoryStorage()
        for storage, error in ((database, KeyboardInterrupt), (memory, RuntimeError)):
            interrupted(toy, arm, storage, error)
            trials = run(toy, arm, TRIALS, storage, 1)
            assert_same(trials, frame, arm, toy.names)
            study = optuna.load_study(study_name=name, storage=storage)
            assert len(study.trials) == TRIALS + 4


@pytest.mark.slow
def test_every_arm_of_the_registry_runs_live_as_compared(
    comparisons,
):
    toy = comparisons.experiment
    comparisons.run("compared", arms=fake_walker.ABLE, runs=2, trials=3)
    frame = comparisons.table("compared").to_pandas()
    for arm in fake_walker.ABLE:
        assert_same(run(toy, arm, 3, number=1), frame, arm, toy.names)


@pytest.mark.slow
@pytest.mark.parametrize("arm", LIVE)
def test_a_trial_found_running_is_run_again(toy, arm, tmp_path):
    """Killed while it was simulated, when it had one of 16 parameters, or none."""
    whole = run(toy, arm, TRIALS)
    storage = open_studies(f"sqlite:///{tmp_path}/studies.db")
    found = find_arm(arm)
    seed = toy.sampler_seed(arm, 0)
    for trials, suggested in ((4, 16), (7, 1), (13, 0)):
        run(toy, arm, trials, storage)
        study = open_study(toy, found, 0, storage)
        task = Task(toy, seed, trials, found.store, found.feature)
        study.sampler = found.new_sampler(task)
        trial = study.ask()
        for name, ends in list(toy.space.items())[:suggested]:
            trial.suggest_float(name, ends.low, ends.high)
    assert facts(run(toy, arm, TRIALS, storage)) == facts(whole)
    states = sorted(trial.state.name for trial in study.get_trials(deepcopy=False))
    assert states == ["COMPLETE"] * TRIALS + ["FAIL"] * 3


class Marks:
    """What leaves a file behind when it is unpickled."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return Path.touch, (self.file,)


@pytest.mark.slow
@pytest.mark.parametrize(
    "arm", [name for name in fake_walker.ABLE if find_arm(name).replayed]
)
def test_nothing_of_a_database_is_unpickled(toy, arm, tmp_path):
    """Optuna's CMA-ES looks for its state in the latest trial that has one."""
    whole = run(toy, arm, 14)  # beyond a generation
    assert not any(trial.system_attrs for trial in whole)  # for others to unpickle
    storage = open_studies(f"sqlite:///{tmp_path}/studies.db")
    run(toy, arm, 12, storage)
    state = json.dumps(pickle.dumps(Marks(tmp_path / "unpickled")).hex())
    study = open_study(toy, find_arm(arm), 0, storage)
    written = [
        (trial._trial_id, "cma:optimizer:0", state)
        for trial in study.get_trials(deepcopy=False)
    ]
    storage.engine.dispose()
    with closing(sqlite3.connect(tmp_path / "studies.db")) as connection, connection:
        columns = "trial_system_attributes (trial_id, key, value_json)"
        connection.executemany(f"INSERT INTO {columns} VALUES (?, ?, ?)", written)
    again = open_studies(f"sqlite:///{tmp_path}/studies.db")
    assert facts(run(toy, arm, 14, again)) == facts(whole)
    assert not (tmp_path / "unpickled").exists()


@pytest.mark.parametrize("is_finished", [False, True])
def test_gains_that_were_not_proposed_are_refused(toy, is_finished):
    """A trial that another has queued, or finished, in a study whose sampler is asked again."""
    storage = InMemoryStorage()
    run(toy, "cmaes-cold", 2, storage)
    study = open_study(toy, find_arm("cmaes-cold"), 0, storage)
    middle = {name: 0.5 * (ends.low + ends.high) for name, ends in toy.space.items()}
    study.enqueue_trial(middle)
    if is_finished:
        trial = study.ask(toy.space)
        for name, written in study.trials[0].user_attrs.items():  # of any walk
            trial.set_user_attr(name, written)
        study.tell(trial, 1.0)
    message = r"cmaes-cold, run 0, trial 2: 'other gains' .*another --out or --storage"
    with refused(message):
        run(toy, "cmaes-cold", 4, storage)


def test_a_repetition_is_not_queued_twice(toy):
    storage = InMemoryStorage()
    study = open_study(toy, find_arm("random"), 0, storage)
    OneStudy(toy, find_arm("random"), 0, study).ask()
    killed = mock.patch.object(optuna.Study, "tell", side_effect=ZeroDivisionError)
    with killed, pytest.raises(ZeroDivisionError):  # in between
        run(toy, "random", 3, storage)
    run(toy, "random", 3, storage)
    states = [trial.state for trial in study.trials]
    assert states == [TrialState.FAIL] + [TrialState.COMPLETE] * 3


@pytest.mark.parametrize("look", range(1, 9))
def test_a_trial_of_the_others(toy, look, monkeypatch):
    """Of a crew, another process tells its trial right after some look of ours at the study."""
    storage = InMemoryStorage()
    get_trials = optuna.Study.get_trials
    looks = count(1)
    arm = find_arm("random")
    other = live_study.LiveStudy(toy, arm, 0, open_study(toy, arm, 0, storage))
    gains = other.ask()

    def looked(study, *args, **options):
        found = get_trials(study, *args, **options)
        if next(looks) == look:
            live_study._simulated(toy, other, gains)
        return found

    monkeypatch.setattr(optuna.Study, "get_trials", looked)
    monkeypatch.setattr(live_study, "WAIT_S", 0.0)
    crew = SimpleNamespace(
        turn=nullcontext, dead=list, alive=lambda number: nullcontext()
    )
    study = run_study(toy, arm, 0, 1, storage, crew=crew)
    assert [trial.state for trial in study.trials] == [TrialState.COMPLETE]


def test_a_study_ends_with_its_first_walker_if_it_is_to(toy):
    """Also in pieces; it is then left alone, whatever is asked for."""
    until = replace(toy, until_walker=True)
    for arm in ("random", "dog", "cmaes-cold"):
        whole = run(toy, arm, TRIALS)
        walked = [bool(trial.user_attrs["walked"]) for trial in whole]
        count = walked.index(True) + 1 if any(walked) else TRIALS
        storage = InMemoryStorage()
        for trials in (1, 4, TRIALS, TRIALS + 9 if any(walked) else TRIALS):
            found = run(until, arm, trials, storage)
            assert facts(found) == facts(whole[: min(trials, count)])
    assert any(walked)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ("seed", r"toy/dog/run-000: seed: 7 .* allowed: 5, with which it was made"),
        ("conditions", r"run-000: terrain\.name: 'flat' .* 'rough"),
        ("stores", r"run-000: stores\.flat: '\w+' .* '\w+', with which it was made"),
    ],
)
def test_another_setting_is_named(changed, message, toy, tmp_path):
    fake_walker.write_store(tmp_path / "other", seed=4)
    values = {
        "seed": 7,
        "conditions": replace(toy.conditions, ground=Ground("flat")),
        "stores": {**toy.stores, "flat": tmp_path / "other"},
    }
    other = replace(toy, **{changed: values[changed]})
    storage = InMemoryStorage()
    run(toy, "dog", 2, storage)
    with refused(message):
        run(other, "dog", 3, storage)
    assert len(run(toy, "dog", 2, storage)) == 2  # nothing was added
    assert len(run(other, "random", 2, storage)) == 2  # another study


def test_a_study_of_another_program_is_refused(toy):
    storage, there = InMemoryStorage(), "toy/dog/run-001"
    optuna.create_study(storage=storage, study_name=there).ask()
    with refused(r"study: 'toy/dog/run-001' .* of another program"):
        run(toy, "dog", 2, storage, 1)
    assert optuna.get_all_study_names(storage) == [there]
    assert len(run(toy, "random", 1, storage, 1)) == 1


@pytest.mark.slow
def test_live_studies_and_comparisons_leave_each_other(toy, tmp_path):
    url = f"sqlite:///{tmp_path}/studies.db"
    request = Request(tmp_path / "out", url, ("dog",), runs=1, trials=2)
    compare(toy, request, lambda progress: None)
    with refused(r"study: 'toy/dog/run-000' .* --storage: .* of a comparison") as live:
        run(toy, "dog", 3, open_studies(url))
    assert len(str(live.value)) < 200
    # A run that it does not have.
    assert len(run(toy, "dog", 3, open_studies(url), 1)) == 3
    with refused("a database without toy/dog/run-001, .* a live") as other:
        compare(toy, replace(request, runs=2), lambda progress: None)
    assert len(str(other.value)) < 200 + len(url)
    study = optuna.load_study(study_name="toy/dog/run-000", storage=url)
    assert len(study.trials) == 2


def test_the_lines_to_look_at_it_name_what_is_not_the_default():
    gains, out = Path("out/a best.json"), Path("out")
    words = "-m taichi_nmm walk --gains 'out/a best.json' --config my.toml"
    assert film_command(gains, Path("my.toml")).endswith(words)
    shipped = film_command(gains, config_path("rough8"), 7, 3)
    assert shipped.endswith("--config rough8 --run 7 --seed 3")
    line = dashboard_command("sqlite:///x.db", out)
    assert line.endswith("-m taichi_nmm dashboard --storage sqlite:///x.db")
    line = dashboard_command("postgresql+psycopg://me:secret@host/walker", out)
    assert line.endswith("--artifacts out") and "secret" not in line


def test_the_lines_name_the_python_in_use(tmp_path, monkeypatch):
    """By a path that is short where it can be, and never one by way of `..`."""
    monkeypatch.setattr("sys.executable", str(tmp_path / "my env" / "bin" / "python"))
    (tmp_path / "elsewhere").mkdir()
    words = ["-m", "taichi_nmm", "walk", "--gains", "gains.json", "--config", "my.toml"]
    for here, shown in ((".", "my env"), ("elsewhere", f"{tmp_path}/my env")):
        monkeypatch.chdir(tmp_path / here)
        line = film_command(Path("gains.json"), Path("my.toml"))
        assert shlex.split(line) == [f"{shown}/bin/python", *words]
