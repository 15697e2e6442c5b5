"""The trials of an experiment in a study database, for the dashboard and Optuna's own tools."""

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

import optuna
import pyarrow as pa
from optuna.distributions import FloatDistribution
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial, create_trial
from optuna_dashboard import save_note, save_plotly_graph_object

from storage.databases.bulk import FinishedStudy, study_attributes, trial_counts, write_studies
from storage.databases.studies import open_studies, shown_url, storage_errors
from study.comparison.experiment import Experiment
from study.comparison.notes import BestCostFigure, summary_note
from taichi_nmm.errors import InputError

ATTRIBUTES = (
    "duration_s", "distance_m", "mean_speed_mps", "end_reason", "walked", "row", "phi_printed",
    "phi_corrected", "survived_fraction",
)  # fmt: skip
CONFIG_ATTRIBUTE = "experiment_config"
FIGURE_ID = "best-cost"


def study_name(experiment: str, arm: str, run: int) -> str:
    """What the study of an arm in a run is called."""
    return f"{experiment}/{arm}/run-{run:03d}"


def export(experiment: Experiment, trials: pa.Table, url: str, final: bool) -> None:
    """Add what is new in the results to the study database, and renew the experiment's summary.

    Args:
        experiment: whose results.
        trials: rows of the results table, every study from its trial 0 on without a gap.
        url: of the database.
        final: whether these are all.

    Raises:
        InputError: the database cannot be used, or has the experiment with another configuration.
    """
    storage = open_studies(url)
    try:
        with storage_errors(url):
            _check(experiment, storage, url)
            counts = trial_counts(storage)
            write_studies(storage, _new_studies(experiment, trials, counts))
            _summarise(experiment, trials, storage, final)
    finally:
        storage.engine.dispose()


def check_database(experiment: Experiment, url: str) -> None:
    """Refuse a database that `export` would refuse, before the work.

    Raises:
        InputError: as `export`.
    """
    storage = open_studies(url)
    try:
        with storage_errors(url):
            _check(experiment, storage, url)
    finally:
        storage.engine.dispose()


def fingerprint(experiment: Experiment) -> str:
    """What decides an experiment's trials, in short: its seed, cost, bodies, ground and search."""
    settings = dataclasses.asdict(experiment.settings)
    for of_machine in ("arch", "threads"):  # an experiment may go on on another one
        settings.pop(of_machine)
    parts = [
        experiment.seed, experiment.cost, experiment.duration_s, experiment.disturbance,
        list(experiment.searched), dict(experiment.ground), settings,
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def _check(experiment: Experiment, storage: RDBStorage, url: str) -> None:
    ours = fingerprint(experiment)
    for name, known in study_attributes(storage, CONFIG_ATTRIBUTE).items():
        if name.startswith(f"{experiment.name}/") and known != ours:
            allowed = f"a database without {name}, which was made with another configuration"
            raise InputError("storage", shown_url(url), allowed)


def _new_studies(
    experiment: Experiment, trials: pa.Table, counts: Mapping[str, int]
) -> Iterator[FinishedStudy]:
    """Each study of the table, with those of its trials that the database does not have."""
    config = fingerprint(experiment)
    columns = ["arm", "run", "trial", *experiment.space, "cost", *ATTRIBUTES]
    table = trials.select(columns).sort_by([(name, "ascending") for name in columns[:3]])
    for arm, run, rows in _groups(table):
        name = study_name(experiment.name, arm, run)
        first = counts.get(name, 0)
        new = rows.slice(first).to_pylist()
        yield FinishedStudy(
            name,
            [_trial(experiment.space, row) for row in new],
            first=min(first, len(rows)),
            user_attrs={
                "experiment": experiment.name, "arm": arm, "run": run, CONFIG_ATTRIBUTE: config,
            },
        )  # fmt: skip


def _groups(table: pa.Table) -> Iterator[tuple[str, int, pa.Table]]:
    """The rows of each arm and run of a sorted table."""
    sizes = table.group_by(["arm", "run"], use_threads=False).aggregate([([], "count_all")])
    start = 0
    for group in sizes.to_pylist():
        yield group["arm"], group["run"], table.slice(start, group["count_all"])
        start += group["count_all"]


def _trial(space: Mapping[str, FloatDistribution], row: Mapping[str, Any]) -> FrozenTrial:
    return create_trial(
        params={name: row[name] for name in space},
        distributions=dict(space),
        value=row["cost"],
        user_attrs={name: row[name] for name in ATTRIBUTES},
    )


def _summarise(experiment: Experiment, trials: pa.Table, storage: RDBStorage, final: bool) -> None:
    """The study that says how the arms compare: a note with a table, and a figure."""
    study = optuna.create_study(
        storage=storage, study_name=f"{experiment.name}/summary", load_if_exists=True
    )
    if CONFIG_ATTRIBUTE not in study.user_attrs:
        study.set_user_attr(CONFIG_ATTRIBUTE, fingerprint(experiment))
    save_note(study, summary_note(experiment.name, trials, final))
    # The dashboard asks of a figure only that it turns into JSON: plotly itself is not needed.
    save_plotly_graph_object(study, BestCostFigure(trials), graph_object_id=FIGURE_ID)
