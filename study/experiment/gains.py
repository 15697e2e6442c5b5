"""Gains to look at: by name, from a file, a store's row, or a finished trial."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.trial import TrialState

import storage
import taichi_nmm
from storage.inputs.errors import InputError
from storage.inputs.reading import is_folder, reading
from storage.simulator import SURVIVED, known_simulator
from storage.store import outcome_name
from study.experiment.walker import WalkerExperiment
from taichi_nmm.parameters import (
    GAIN_NAMES,
    GAINS,
    LOW_LEVEL_GAINS,
    LOW_LEVEL_NAMES,
    check_gains,
    load_all_gains,
)
from taichi_nmm.result import ENERGY, OF_MUSCLES

NUMBER = re.compile(r"\d{1,100}")  # Python refuses to read thousands of digits
TRIAL = re.compile(rf"([^/]*)/([^/]*)/(?:run-)?({NUMBER.pattern})/({NUMBER.pattern})")
SPEED_TOLERANCE_MPS = 0.05
TRIAL_FORM = "EXPERIMENT/ARM/run-NNN/NUMBER, such as rough8-smooth/dog/run-007/12"


@dataclass(frozen=True, eq=False)
class NamedGains:
    """All gains of a controller, and their name.

    Attributes:
        name: for titles and file names.
        gains: in the order of `GAINS`, [16].
        low_level: in the order of `LOW_LEVEL_GAINS`, [28].
        later: gains that follow, each for an equal part of a walk; empty: these are
            kept.
    """

    name: str
    gains: NDArray[np.float64]
    low_level: NDArray[np.float64]
    later: tuple["NamedGains", ...] = ()

    def by_name(self) -> dict[str, float]:
        """All gains, searched and low-level, by name."""
        values = (*self.gains.tolist(), *self.low_level.tolist())
        return dict(zip((*GAIN_NAMES, *LOW_LEVEL_NAMES), values, strict=True))

    def as_document(self) -> dict[str, float]:
        """By name, as a gains file has them; low-level gains where they are not the defaults."""
        changed = {
            parameter.name: value
            for parameter, value in zip(
                LOW_LEVEL_GAINS, self.low_level.tolist(), strict=True
            )
            if value != parameter.default
        }
        return dict(zip(GAIN_NAMES, self.gains.tolist(), strict=True)) | changed


def gains_of_source(source: str) -> NamedGains:
    """Gains by name (published, reference), or of a JSON file.

    Raises:
        InputError: as `taichi_nmm.load_all_gains`.
    """
    return NamedGains(Path(source).stem, *load_all_gains(source))


def gains_of_row(store: Path, row: int) -> NamedGains:
    """The point of a store's row.

    Raises:
        InputError: no such store or row, or a store of another simulator than the
            walker.
    """
    opened = storage.open_store(store)
    known_simulator(opened.specification)
    if not 0 <= row < len(opened):
        raise InputError("row", row, f"0 to {len(opened) - 1}, the rows of {store}")
    return gains_at(opened, row, row)


def row_at_speed(store: Path, speed_mps: float, least: str = ENERGY) -> int:
    """The row of a store that walks at a speed with the least energy per metre.

    It lasts in all worlds of the family that runs longest (without families, on level
    ground), and its mean speed there is within `SPEED_TOLERANCE_MPS`.

    Args:
        store: its folder or file.
        speed_mps: that is asked for.
        least: the column of which the row has the least, in the mean over these worlds.
            A store that was made before version 0.4 may lack the energy of the motors:
            see `has_worlds_of`.

    Raises:
        InputError: no such store, no such row, or no such column of its worlds.
    """
    opened = storage.open_store(store)
    known_simulator(opened.specification)
    if not has_worlds_of(opened, least):
        allowed = f"a column of each world of {store}, as {OF_MUSCLES}; or compute the store anew"
        raise InputError("least", least, allowed)
    names = (SURVIVED, "mean_speed_mps", least)
    if opened.families:
        lasted, speeds, spent = (
            opened.outcomes(longest_family(opened), name) for name in names
        )
    else:
        rows = opened.numpy(names)
        lasted, speeds, spent = (rows[name][:, None] for name in names)
    lasts, speed, energy = (
        (lasted >= 1.0).all(axis=1),
        speeds.mean(axis=1),
        spent.mean(axis=1),
    )
    near = lasts & (np.abs(speed - speed_mps) <= SPEED_TOLERANCE_MPS)
    if not near.any():
        ends = (speed[lasts].min(), speed[lasts].max()) if lasts.any() else (0.0, 0.0)
        allowed = (
            f"near that of a row of {store} that lasts: {ends[0]:.2f} to {ends[1]:.2f}"
        )
        raise InputError("speed", speed_mps, allowed)
    return int(np.where(near, energy, np.inf).argmin())


def longest_family(store: storage.Store) -> str:
    """The family of a store whose worlds last longest."""
    return max(
        store.families, key=lambda name: float(store.settings_of(name)["horizon_s"])
    )


def has_worlds_of(store: storage.Store, column: str) -> bool:
    """Whether a store has a column for each world that `row_at_speed` looks at."""
    if not store.families:
        return column in store.columns
    return outcome_name(longest_family(store), column) in store.columns


def gains_at(store: storage.Store, place: int, row: int) -> NamedGains:
    """The point at a place among a store's rows, called by the number of its row."""
    fixed: dict[str, Any] = store.specification.get("fixed_gains", {})
    values = fixed | store.table(store.parameter_names).slice(place, 1).to_pylist()[0]
    return named_gains(f"{store.path.name}-{store.ROW}-{row}", values)


def gains_of_trial(trial: str, where: str) -> NamedGains:
    """The parameters of a finished trial, STUDY/NUMBER.

    `where` is the URL of a study database, or a comparison's folder.

    Raises:
        InputError: no such database or folder, study or trial.
    """
    study, _, number = trial.rpartition("/")
    if not study or not NUMBER.fullmatch(number):
        raise InputError("trial", trial, TRIAL_FORM)
    if is_folder(where):
        values = _of_folder(Path(where), trial)
    else:
        values = _of_database(where, study, int(number))
    return named_gains(trial.replace("/", "-"), values)


def _of_folder(folder: Path, trial: str) -> dict[str, Any]:
    import pyarrow.compute as pc  # what takes long to load, here and below, is loaded where used

    from storage.tables import read_columns
    from study.experiment.folder import RESULTS_NAME, table_files

    paths = table_files(folder)
    if not paths:
        raise InputError(
            "storage", str(folder), f"a comparison's folder, with {RESULTS_NAME}"
        )
    named = TRIAL.fullmatch(trial)
    if named:
        experiment, arm, run, number = named.groups()
        wanted = {
            "experiment": experiment,
            "arm": arm,
            "run": int(run),
            "trial": int(number),
        }
        for path in paths:
            table = read_columns(path)
            with reading("storage", path, "a comparison's table of trials"):
                # as text: a number may be too large for Arrow
                for name, value in wanted.items():
                    table = table.filter(
                        pc.equal(table[name].cast("string"), str(value))
                    )
            if len(table):
                row: dict[str, Any] = table.to_pylist()[0]
                return row
    where = paths[0] if paths[0].parent == folder else paths[0].parent
    raise InputError("trial", trial, f"a finished trial of {where}: {TRIAL_FORM}")


def _of_database(url: str, name: str, number: int) -> dict[str, Any]:
    from storage.databases.studies import read_studies, shown_url, studies_path
    from storage.databases.urls import SQLITE

    shown = shown_url(url)  # refuses what is no such URL
    if url.startswith(SQLITE) and not studies_path(url).is_file():
        raise InputError(
            "storage", shown, "a database that is there, or a comparison's folder"
        )
    with read_studies(url) as storage:
        if storage is None or name not in optuna.get_all_study_names(storage):
            raise InputError("trial", f"{name}/{number}", f"a study of {shown}")
        study = optuna.load_study(study_name=name, storage=storage)
        trials, known = (
            study.get_trials(deepcopy=False),
            study.user_attrs.get("experiment"),
        )
    if number >= len(trials) or trials[number].state is not TrialState.COMPLETE:
        raise InputError("trial", f"{name}/{number}", f"a finished trial of {shown}")
    fixed: dict[str, Any] = (
        known.get("fixed_gains", {}) if isinstance(known, dict) else {}
    )
    return fixed | trials[number].params


def named_gains(name: str, values: Mapping[str, Any]) -> NamedGains:
    """Gains among other values; low-level gains that are not there have their defaults."""
    both = {parameter.name: parameter.default for parameter in LOW_LEVEL_GAINS}
    both |= {
        key: values[key] for key in (*GAIN_NAMES, *LOW_LEVEL_NAMES) if key in values
    }
    gains, low_level = np.split(
        check_gains(both, (*GAINS, *LOW_LEVEL_GAINS)), [len(GAINS)]
    )
    return NamedGains(name, gains, low_level)


def recorded_walk(
    gains: NamedGains,
    experiment: WalkerExperiment,
    run: int,
    rate_hz: float,
    progress: Callable[[float, int], None] | None = None,
) -> taichi_nmm.Result:
    """The result of one walker on the body and the ground of a run, with its trajectory.

    Args:
        gains: that walk, and those that follow them.
        experiment: whose conditions they walk in.
        run: of the experiment, from 0.
        rate_hz: samples a second of the trajectory, a divisor of 1000.
        progress: as `taichi_nmm.simulate` takes it.

    Raises:
        InputError: what the simulator refuses.
    """
    conditions = experiment.conditions
    part_s = conditions.duration_s / (1 + len(gains.later))
    switches = [
        taichi_nmm.Switch(part_s * number, later.gains, later.low_level)
        for number, later in enumerate(gains.later, start=1)
    ]
    return taichi_nmm.simulate(
        gains.gains,
        low_level_gains=gains.low_level,
        duration_s=conditions.duration_s,
        bodies=experiment.body(run),
        worlds=experiment.world(run),
        terrains=experiment.terrain(run),
        switches=switches,
        settings=conditions.settings,
        record=[0],
        record_rate_hz=rate_hz,
        progress=progress,
    )
