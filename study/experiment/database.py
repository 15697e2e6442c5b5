"""An experiment in a study database: all its trials, for the explorer and Optuna's own tools."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import pyarrow as pa
from optuna.storages import RDBStorage
from optuna.trial import create_trial

from storage.databases.bulk import (
    FinishedStudy,
    study_attributes,
    trial_counts,
    write_studies,
)
from storage.databases.studies import (
    open_studies,
    read_studies,
    shown_url,
    storage_errors,
)
from storage.inputs.errors import InputError
from study.experiment.experiment import Experiment, study_name
from study.experiment.folder import LIVE_ATTRIBUTE, MEASURED, by_study, fingerprint
from study.experiment.one_study import COST_ATTRIBUTE, params_of
from study.sampler.history import ROW_ATTRIBUTE

CONFIG_ATTRIBUTE = "experiment_config"


def export(experiment: Experiment, trials: pa.Table, url: str) -> None:
    """Add new results to the study database.

    The trials are rows of the results table, every study from its trial 0 on without a
    gap.

    Raises:
        InputError: the database cannot be used, or has the experiment with another
            configuration.
    """
    with opened(url) as storage:
        _check(experiment, storage, url)
        write_studies(storage, _new_studies(experiment, trials, trial_counts(storage)))


@contextmanager
def opened(url: str) -> Iterator[RDBStorage]:
    """The study database, closed at the end; an error of it is one line."""
    storage = open_studies(url)
    try:
        with storage_errors(url):
            yield storage
    finally:
        storage.engine.dispose()


def check_database(experiment: Experiment, url: str) -> None:
    """Refuse a database that `export` would refuse, before the work.

    Nothing is written, and no database is made.

    Raises:
        InputError: as `export`.
    """
    with read_studies(url) as storage:
        if storage is None:
            return
        _check(experiment, storage, url)
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
