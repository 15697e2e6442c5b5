"""What SQLite itself writes is what Optuna would have written, and Optuna reads it."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import optuna
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution
from optuna.study import StudyDirection
from optuna.trial import TrialState, create_trial

from storage.databases.files import read_attributes, read_errors
from storage.databases.plain import PlainStudies, is_known
from storage.databases.studies import open_studies
from storage.inputs.errors import InputError

SPACE = {
    "x": FloatDistribution(0.1, 10.0, log=True),
    "shoe": CategoricalDistribution(("soft", "hard", None)),
}
MAXIMISED = StudyDirection.MAXIMIZE


def trial_of(value, note="", x=0.3):
    """A trial with this value; None: it runs."""
    is_told = value is not None
    return create_trial(
        state=TrialState.COMPLETE if is_told else TrialState.RUNNING,
        value=value,
        params={"x": x, "shoe": None},
        distributions=SPACE,
        user_attrs={"note": note, "row": 3},
        constraints={"torque": -1.5} if is_told else None,
    )


@pytest.fixture
def url(tmp_path):
    """Of a database that Optuna has made."""
    found = f"sqlite:///{tmp_path}/studies.db"
    optuna.create_study(storage=open_studies(found), study_name="another")
    return found


def shown(url):
    """The trials, as Optuna reads them."""
    storage = optuna.storages.RDBStorage(url)
    study = optuna.load_study(study_name="walk", storage=storage)
    assert study.direction is MAXIMISED
    return study.trials


def assert_equal(found, wanted):
    for number, (trial, own) in enumerate(zip(found, wanted, strict=True)):
        assert trial.number == number
        for part in ("state", "values", "params", "distributions", "user_attrs"):
            assert getattr(trial, part) == getattr(own, part)
        assert trial.system_attrs == own.system_attrs
        assert trial.datetime_complete == own.datetime_complete


def test_trials_are_those_that_optuna_would_have_added(url):
    studies = PlainStudies(url)
    wanted = [trial_of(1.5, "é"), trial_of(-np.inf), trial_of(None, "runs")]
    studies.bring("walk", MAXIMISED, wanted)
    study = optuna.create_study(direction="maximize")
    study.add_trials(wanted)
    assert_equal(shown(url), study.trials)
    begun = [trial.datetime_start for trial in wanted]
    assert [trial.datetime_start for trial in shown(url)] == begun
    studies.bring("walk", MAXIMISED, wanted)  # nothing is to be done
    assert_equal(shown(url), study.trials)


def test_a_trial_that_runs_may_be_finished_and_one_that_was_corrected_makes_all_anew(
    url,
):
    studies = PlainStudies(url)
    studies.bring("walk", MAXIMISED, [trial_of(None)])
    (runs,) = shown(url)
    finished = [trial_of(2.0, "told"), trial_of(None)]
    studies.bring("walk", MAXIMISED, finished)
    assert_equal(shown(url), finished)
    assert shown(url)[0]._trial_id == runs._trial_id
    corrected = [trial_of(1.0), trial_of(3.0)]
    studies.bring("walk", MAXIMISED, corrected)
    assert_equal(shown(url), corrected)
    studies.bring("walk", MAXIMISED, corrected[:1])
    assert_equal(shown(url), corrected[:1])


def test_attributes_are_kept_and_a_transaction_is_whole_or_not_there(url):
    studies = PlainStudies(url)
    for value in ({"a": [1, 0.1]}, {"a": None}):
        studies.set_attribute("walk (log)", "entry", value)
        studies.write_down()
        assert read_attributes(url, "walk (log)")[0] == {"entry": value}
    with pytest.raises(RuntimeError), studies.transaction():
        studies.set_attribute("walk (log)", "entry", 2)
        raise RuntimeError
    assert read_attributes(url, "walk (log)")[0] == {"entry": {"a": None}}


@pytest.mark.parametrize(
    "edit",
    [
        "UPDATE trial_values SET objective = 0.5",
        "UPDATE trial_values SET value = 'much'",
        "UPDATE trial_params SET param_value = 'thick'",
        "UPDATE trial_params SET distribution_json = '{'",
        "UPDATE trial_user_attributes SET value_json = 'x'",
        "UPDATE trials SET state = 'LOST'",
        "UPDATE study_directions SET direction = 'UP'",
    ],
)
def test_what_optuna_could_not_read_is_refused(url, edit):
    studies = PlainStudies(url)
    studies.bring("walk", MAXIMISED, [trial_of(1.0)])
    studies.require_readable("walk")
    studies.require_readable("nothing")
    with closing(sqlite3.connect(url.removeprefix("sqlite:///"))) as database:
        database.execute(edit)
        database.commit()
    with pytest.raises(InputError, match=r"storage: .*studies\.db"), read_errors(url):
        studies.require_readable("walk")


def test_a_file_of_another_schema_is_left_to_optuna(url, tmp_path):
    assert is_known(url)
    assert not is_known(f"sqlite:///{tmp_path}/none.db")
    with closing(sqlite3.connect(url.removeprefix("sqlite:///"))) as database:
        database.execute("UPDATE alembic_version SET version_num = 'v2.6.0.a'")
        database.commit()
    assert not is_known(url)


def test_a_file_that_was_removed_is_not_written(url):
    studies = PlainStudies(url)
    Path(url.removeprefix("sqlite:///")).unlink()
    with pytest.raises(InputError, match="no trial since then is kept"):
        studies.set_attribute("walk (log)", "entry", 1)
    studies.close()
