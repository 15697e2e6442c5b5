"""An experiment in a study database, for the dashboard and Optuna's own tools.

The database gets all trials, a study that compares the arms, and notes on the features'
worth.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product

import optuna
import pyarrow as pa
from optuna.storages import RDBStorage
from optuna.trial import create_trial

from storage.databases.bulk import (
    FinishedStudy,
    study_attributes,
    study_ids,
    trial_counts,
    write_studies,
)
from storage.databases.studies import (
    load_whole,
    open_studies,
    read_errors,
    read_studies,
    shown_url,
    storage_errors,
    study_of_costs,
)
from storage.inputs.errors import InputError
from study.experiment.arms import Arm
from study.experiment.experiment import SUMMARY, Experiment, study_name
from study.experiment.folder import (
    LIVE_ATTRIBUTE,
    MEASURED,
    as_if_gone_on,
    by_study,
    fingerprint,
)
from study.experiment.live_study import require_notes, require_written
from study.experiment.one_study import COST_ATTRIBUTE, note_worth, params_of
from study.sampler.history import ROW_ATTRIBUTE

CONFIG_ATTRIBUTE = "experiment_config"

Summarise = Callable[[str, pa.Table, bool, Mapping[str, int]], str]
"""Makes a note, in Markdown, of an experiment's name, its results, whether these are
all, and the numbers that the dashboard's addresses have for studies, by name."""


def export(
    experiment: Experiment,
    trials: pa.Table,
    url: str,
    summarise: Summarise | None,
    final: bool,
) -> None:
    """Add new results to the study database, and renew the experiment's summary.

    The trials are rows of the results table, every study from its trial 0 on without a
    gap; `final` says whether these are all. Without `summarise` there is no summary
    study.

    Raises:
        InputError: the database cannot be used, or has the experiment with another
            configuration.
    """
    with opened(url) as storage:
        _check(experiment, storage, url)
        write_studies(storage, _new_studies(experiment, trials, trial_counts(storage)))
        if summarise is None:
            return
        shown = as_if_gone_on(trials) if experiment.until_walker else trials
        note = summarise(experiment.name, shown, final, study_ids(storage))
        from optuna_dashboard import save_note  # a second, once a minute

        name = f"{experiment.name}{SUMMARY}"
        with read_errors(url):
            study = study_of_costs(storage, name, experiment.objective.metrics)
            known = study.user_attrs
        if CONFIG_ATTRIBUTE not in known:
            study.set_user_attr(CONFIG_ATTRIBUTE, fingerprint(experiment))
        save_note(study, note)


@contextmanager
def opened(url: str) -> Iterator[RDBStorage]:
    """The study database, closed at the end; an error of it is one line."""
    storage = open_studies(url)
    try:
        with storage_errors(url):
            yield storage
    finally:
        storage.engine.dispose()


def check_database(
    experiment: Experiment, url: str, arms: Sequence[Arm] = (), runs: Sequence[int] = ()
) -> None:
    """Refuse a database that `export` or `note_worths` would refuse, before the work.

    Nothing is written, and no database is made.

    Raises:
        InputError: as `export` and `note_worths`.
    """
    with read_studies(url) as storage:
        if storage is None:
            return
        _check(experiment, storage, url)
        if (name := f"{experiment.name}{SUMMARY}") in study_ids(storage):
            load_whole(storage, name)
            require_notes(name, storage)
        for _, _, name in _noted(storage, experiment, arms, runs):
            _checked(storage, name, experiment, url)
    open_studies(url).engine.dispose()  # it is there and ours, but may be locked


def _check(experiment: Experiment, storage: RDBStorage, url: str) -> None:
    ours = fingerprint(experiment)
    for name, known in study_attributes(storage, CONFIG_ATTRIBUTE).items():
        if name.startswith(f"{experiment.name}/") and known != ours:
            allowed = (
                f"a database without {name}, which was made with another configuration or version: "
                "remove it, since all that is in it is written again, or give another --storage"
            )
            raise InputError("storage", shown_url(url), allowed)
    for name, known in study_attributes(storage, LIVE_ATTRIBUTE).items():
        if name.startswith(f"{experiment.name}/") and isinstance(known, dict):
            allowed = f"a database without {name}, which is a live study; or another --storage"
            raise InputError("storage", shown_url(url), allowed)


def _new_studies(
    experiment: Experiment, trials: pa.Table, counts: Mapping[str, int]
) -> Iterator[FinishedStudy]:
    """Each study of the table, with those of its trials that the database does not have."""
    objective, names = experiment.objective, experiment.names
    values, attributes = objective.columns, (ROW_ATTRIBUTE, *experiment.attributes)
    if experiment.noise:
        values, attributes = [MEASURED], (*attributes, COST_ATTRIBUTE)
    columns = ["arm", "run", "trial", *names, *values, *attributes]
    for arm, run, rows in by_study(trials.select(columns)):
        name = study_name(experiment.name, arm, run)
        first = counts.get(name, 0)
        new = [
            create_trial(
                params=params_of(experiment, [row[name] for name in names]),
                distributions=dict(experiment.space),
                values=[row[name] for name in values],
                user_attrs={name: row[name] for name in attributes},
            )
            for row in rows.slice(first).to_pylist()
        ]
        first = min(first, len(rows))
        known = {
            "experiment": experiment.name,
            "arm": arm,
            "run": run,
            CONFIG_ATTRIBUTE: fingerprint(experiment),
        }
        yield FinishedStudy(
            name, new, first=first, user_attrs=known, metrics=objective.metrics
        )


def note_worths(
    experiment: Experiment,
    arms: Sequence[Arm],
    runs: Sequence[int],
    url: str,
    renew: bool,
) -> None:
    """Write or renew the notes of exported studies; arms without features have none.

    If not `renew`, there are no new trials, and a study that has a note keeps it.

    Raises:
        InputError: the database cannot be used.
    """
    if not any(arm.feature for arm in arms):
        return
    from optuna_dashboard import get_note  # a second

    with opened(url) as storage:
        for arm, run, name in _noted(storage, experiment, arms, runs):
            if not renew and get_note(
                optuna.load_study(study_name=name, storage=storage)
            ):
                continue  # without a look at its trials, which take far longer
            note_worth(experiment, arm, run, _checked(storage, name, experiment, url))


def _noted(
    storage: RDBStorage,
    experiment: Experiment,
    arms: Iterable[Arm],
    runs: Sequence[int],
) -> Iterator[tuple[Arm, int, str]]:
    """Each study that has trials and gets a note, by its name."""
    counts = trial_counts(storage)
    for arm, run in product((arm for arm in arms if arm.feature), runs):
        name = study_name(experiment.name, arm.name, run)
        if counts.get(name):
            yield arm, run, name


def _checked(
    storage: RDBStorage, name: str, experiment: Experiment, url: str
) -> optuna.Study:
    """The study, its trials and its note as this project writes them."""
    with read_errors(url):
        study = load_whole(storage, name)
        require_notes(name, storage)
    require_written(study, experiment)
    return study
