"""Studies from first trial to last: what they record, and that interruptions leave no trace."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
import pytest
from optuna.trial import FrozenTrial, TrialState

import taichi_nmm
from storage.databases.studies import open_studies
from study import FeatureTable
from study.arms import ARMS, new_sampler
from study.config import StudyConfig, read_study_config
from study.objective import WalkObjective, simulate_gains, suggest_gains
from study.runner import finished, open_study, run_study, study_name
from study.summary import best_gains, progress_line, summary, summary_text
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, GAINS
from taichi_nmm.result import Result
from tests.study import fake_walker

ROUGH8 = Path(__file__).parents[2] / "configs" / "rough8.toml"


@pytest.fixture
def config() -> StudyConfig:
    return read_study_config(ROUGH8)


@pytest.fixture
def stored(store: Path) -> FeatureTable:
    return FeatureTable.from_parquet(store, features=["phi_printed"])


def run(
    config: StudyConfig,
    arm: str,
    trials: int,
    stored: FeatureTable,
    storage: optuna.storages.BaseStorage,
) -> list[FrozenTrial]:
    return finished(run_study(config, arm, trials, storage, candidates(arm, stored)))


def candidates(arm: str, stored: FeatureTable) -> FeatureTable | None:
    """What an arm chooses among: the store's rows, compared by as many numbers as it wants."""
    if arm != "best":
        return stored if arm == "dog" else None
    rows = stored.rows
    space = rows.space.as_dict()
    columns = {name: rows.parameters[:, column] for column, name in enumerate(space)}
    features = np.column_stack([rows.features[:, 0], rows.parameters[:, 0]])
    return FeatureTable.from_arrays(columns, features, ["survival", "speed"], space=space)


@pytest.mark.parametrize("arm", ARMS)
def test_trials_say_what_happened(config: StudyConfig, stored: FeatureTable, arm: str) -> None:
    trials = run(config, arm, 5, stored, optuna.storages.InMemoryStorage())
    assert len(trials) == 5
    for trial in trials:
        assert tuple(trial.params) == GAIN_NAMES
        attributes = trial.user_attrs
        assert attributes["end_reason"] in ("completed", "fell", "diverged")
        assert 0 < attributes["duration_s"] <= 100
        assert attributes["distance_m"] == pytest.approx(
            attributes["duration_s"] * attributes["mean_speed_mps"]
        )
        assert ("row" in attributes) == (arm in ("dog", "best"))
        assert ("score" in attributes) == (arm == "dog")


def test_the_cost_is_the_configured_one(config: StudyConfig, fake_simulator: None) -> None:
    trial = optuna.trial.FixedTrial({gain.name: gain.default for gain in GAINS})
    rows = simulate_gains(config, suggest_gains(trial)).rows
    assert WalkObjective(config)(trial) == taichi_nmm.smooth_cost(rows)[0]
    walking = replace(config, cost="walking")
    assert WalkObjective(walking)(trial) == taichi_nmm.walking_cost(rows)[0]


@pytest.mark.parametrize("arm", ARMS)
def test_a_study_in_pieces_is_the_same_study(
    config: StudyConfig, stored: FeatureTable, arm: str, tmp_path: Path
) -> None:
    whole = run(config, arm, 16, stored, optuna.storages.InMemoryStorage())
    url = f"sqlite:///{tmp_path}/studies.db"
    for trials in (1, 4, 13, 16):
        pieces = run(config, arm, trials, stored, open_studies(url))
        assert len(pieces) == trials
    assert [trial.params for trial in pieces] == [trial.params for trial in whole]


@pytest.mark.parametrize("arm", ["dog", "random"])
def test_interrupted_trials_are_run_again(
    config: StudyConfig, stored: FeatureTable, arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run(config, arm, 8, stored, optuna.storages.InMemoryStorage())
    storage, calls = optuna.storages.InMemoryStorage(), iter(range(100))

    def sometimes(*args: object, **options: object) -> Result:
        if next(calls) in (0, 4, 5):
            raise KeyboardInterrupt
        return fake_walker.simulate(*args, **options)

    monkeypatch.setitem(vars(taichi_nmm), "simulate", sometimes)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            run(config, arm, 8, stored, storage)
    trials = run(config, arm, 8, stored, storage)
    assert [trial.params for trial in trials] == [trial.params for trial in whole]


def test_a_trial_found_running_is_run_again(config: StudyConfig, stored: FeatureTable) -> None:
    whole = run(config, "dog", 6, stored, optuna.storages.InMemoryStorage())
    storage = optuna.storages.InMemoryStorage()
    run(config, "dog", 4, stored, storage)
    study = open_study(config, "dog", storage, stored)
    study.sampler = new_sampler("dog", config, stored, turn=4)
    study.ask().suggest_float("K_GAS", 0.0, 8.0)  # killed after the first of 16 parameters
    trials = run(config, "dog", 6, stored, storage)
    assert [trial.params for trial in trials] == [trial.params for trial in whole]
    states = [trial.state for trial in study.get_trials(deepcopy=False)]
    assert states.count(TrialState.FAIL) == 1
    assert TrialState.RUNNING not in states


def test_a_repetition_queued_before_the_kill_is_not_queued_twice(
    config: StudyConfig, stored: FeatureTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage = optuna.storages.InMemoryStorage()
    study = open_study(config, "random", storage, None)
    study.ask()
    monkeypatch.setattr(optuna.Study, "tell", lambda *_, **__: 1 / 0)  # killed in between
    with pytest.raises(ZeroDivisionError):
        run(config, "random", 3, stored, storage)
    monkeypatch.undo()
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    run(config, "random", 3, stored, storage)
    states = [trial.state for trial in study.trials]
    assert states == [TrialState.FAIL] + [TrialState.COMPLETE] * 3


def test_a_finished_study_is_left_alone(config: StudyConfig, stored: FeatureTable) -> None:
    storage = optuna.storages.InMemoryStorage()
    assert run(config, "dog", 5, stored, storage) == run(config, "dog", 3, stored, storage)


def test_another_configuration_is_refused_by_name(
    config: StudyConfig, stored: FeatureTable
) -> None:
    storage = optuna.storages.InMemoryStorage()
    run(config, "dog", 2, stored, storage)
    with pytest.raises(InputError, match=r"study rough8/dog: seed: 7 .* allowed: 1, with which"):
        run(replace(config, seed=7), "dog", 3, stored, storage)
    with pytest.raises(InputError, match=r"rough8/dog: simulation\.duration_s: 50"):
        run(replace(config, duration_s=50.0), "dog", 3, stored, storage)
    with pytest.raises(InputError, match=r"rough8/dog: dog.score: 'phi_corrected'"):
        run(replace(config, score="phi_corrected"), "dog", 3, stored, storage)
    assert len(run(config, "random", 2, stored, storage)) == 2  # another study


def test_another_programs_study_is_refused(config: StudyConfig, stored: FeatureTable) -> None:
    storage = optuna.storages.InMemoryStorage()
    optuna.create_study(storage=storage, study_name="rough8/dog").ask()
    with pytest.raises(InputError, match="study: 'rough8/dog'"):
        run(config, "dog", 2, stored, storage)


def test_more_trials_than_rows_are_refused(config: StudyConfig, stored: FeatureTable) -> None:
    with pytest.raises(InputError, match=r"trials: 201 .* at most 200"):
        run(config, "dog", 201, stored, optuna.storages.InMemoryStorage())


def test_the_samplers_start_apart(config: StudyConfig, stored: FeatureTable) -> None:
    starts = {
        (arm, seed): run(
            replace(config, seed=seed), arm, 2, stored, optuna.storages.InMemoryStorage()
        )[1].params["K_GAS"]
        for arm in ARMS
        for seed in (1, 2)
    }
    assert len(set(starts.values())) == len(starts)


def test_what_a_study_says(config: StudyConfig, stored: FeatureTable) -> None:
    lines = []
    study = run_study(
        config,
        "dog",
        6,
        optuna.storages.InMemoryStorage(),
        stored,
        lambda study, trial: lines.append(progress_line(study, trial, 6)),
    )
    assert len(lines) == 6
    assert lines[5].startswith("rough8/dog  6/6  cost ")
    found = summary(study, "sqlite:///x.db", Path("out/best.json"))
    assert found["study"] == study_name(config, "dog")
    assert found["best_cost"] == study.best_value
    assert found["dashboard"].endswith("optuna-dashboard sqlite:///x.db")
    assert best_gains(study) == study.best_params
    text = summary_text(study, "sqlite:///x.db", Path("out/best.json"))
    assert text.splitlines()[-1].endswith("optuna-dashboard sqlite:///x.db")
