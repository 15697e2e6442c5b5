"""The worth of features as the note of live studies, of a comparison's, and of anybody's."""

from dataclasses import replace
from unittest.mock import Mock

import optuna
import pytest
from optuna.storages import InMemoryStorage
from optuna_dashboard import get_note, save_note

from storage.databases.bulk import trial_counts
from storage.databases.studies import load_whole, open_studies
from study.experiment.arms import find_arm
from study.experiment.compare import Request, compare
from study.experiment.experiment import study_name
from study.experiment.live_study import run_study
from study.experiment.one_study import worth_of_study
from tests.study import fake_walker

TITLE = "## Are the features worth anything?"


@pytest.mark.parametrize(
    ("arm", "beginning", "words"),
    [
        ("dog", TITLE, ("6 trials.", "\n| phi_printed | ")),
        ("worlds", "## Which worlds is the robot like?", ("By 6 trials,", "rough")),
        ("random", "", ()),
        ("bo-euclidean", "", ()),
        ("ranking", "", ()),
    ],
)
def test_a_live_study_has_it_at_its_end(toy, arm, beginning, words):
    note = get_note(run_study(toy, find_arm(arm), 0, 6, InMemoryStorage()))
    assert bool(note) == bool(beginning)
    assert note.startswith(beginning) and all(word in note for word in words)


def test_it_is_renewed_and_a_note_of_the_users_stays(toy):
    storage = InMemoryStorage()
    study = run_study(toy, find_arm("dog"), 0, 3, storage)
    assert "too few trials: 3 of 5" in get_note(study)
    study = run_study(toy, find_arm("dog"), 0, 6, storage)
    assert "too few" not in get_note(study)
    again = run_study(toy, find_arm("dog"), 0, 6, storage)
    assert get_note(again) == get_note(study)
    save_note(study, "mine")
    assert get_note(run_study(toy, find_arm("dog"), 0, 7, storage)) == "mine"


def test_every_arm_over_features_can_tell(toy):
    for arm in map(find_arm, fake_walker.ABLE):
        study = run_study(toy, find_arm("random"), 0, 1, InMemoryStorage())
        worth = worth_of_study(toy, arm, 0, study)
        assert (
            worth is None
            or arm.name.startswith("worlds")
            or worth.names == (arm.feature,)
        )
        assert (worth is not None) == arm.name.startswith(("dog", "worlds"))


def notes(url):
    """Of each study of a database."""
    storage = open_studies(url)
    names = trial_counts(storage)
    return {
        name: get_note(optuna.load_study(study_name=name, storage=storage))
        for name in names
    }


@pytest.mark.slow
def test_each_study_of_a_comparison_over_features_has_its_own(
    toy, tmp_path, monkeypatch
):
    def outcome(**changes):
        request = {"runs": 2, "trials": 6} | changes
        return compare(toy, Request(tmp_path / "out", **request), lambda progress: None)

    url = outcome(arms=("dog", "random")).storage
    first = notes(url)
    dogs = [first[study_name("toy", "dog", run)] for run in range(2)]
    assert all(note.startswith(TITLE) and "6 trials." in note for note in dogs)
    assert [first[study_name("toy", "random", run)] for run in range(2)] == ["", ""]
    live = run_study(toy, find_arm("dog"), 1, 6, InMemoryStorage())
    assert get_note(live) == dogs[1]  # to the letter
    before = (tmp_path / "out" / "trials.parquet").read_bytes()
    with monkeypatch.context() as context:
        context.setattr("study.experiment.database.note_worth", None)  # or it is called
        read = Mock(wraps=load_whole)
        context.setattr("study.experiment.database.load_whole", read)
        outcome(arms=("dog",))  # no new trials, no new notes
        assert read.call_count == 2  # each study once
    assert notes(url) == first
    assert (tmp_path / "out" / "trials.parquet").read_bytes() == before
    outcome(arms=("dog",), trials=7)
    assert "7 trials." in notes(url)[study_name("toy", "dog", 0)]


def test_arms_of_earlier_sessions_need_no_store(toy, tmp_path):
    request = Request(tmp_path / "out", runs=1, trials=3, arms=("dog",))
    compare(toy, request, lambda progress: None)
    without = replace(toy, stores={})
    outcome = compare(
        without, replace(request, arms=("random",)), lambda progress: None
    )
    assert TITLE in notes(outcome.storage)[study_name("toy", "dog", 0)]
