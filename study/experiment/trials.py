"""Trials of an experiment: simulated as one batch, what they cost, and whether they walked."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import optuna
from numpy.typing import ArrayLike, NDArray
from optuna.trial import FrozenTrial, TrialState

import taichi_nmm
from study.experiment.experiment import Experiment
from study.experiment.objective import Objective
from study.sampler.history import ROW_ATTRIBUTE, SCORE_ATTRIBUTE
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import searched_parameters, split_points
from taichi_nmm.result import COMPLETED, END_REASONS, SCORE_FIELDS
from taichi_nmm.world import Worlds

WALKING_SPEED_MPS = (
    0.3  # slower, a walker that lasted to the end has stood rather than walked
)

MEASURES = ("duration_s", "distance_m", "mean_speed_mps")  # named in words about a walk

# Columns kept of a trial beside its cost: how it ended, and the components of the
# score.
OUTCOMES = (*MEASURES, "cost_of_transport_jpkgpm")
KEPT = (*OUTCOMES, *(name for name, _ in SCORE_FIELDS))

# Attributes of a trial in a study database, for readers.
ATTRIBUTES = (
    *MEASURES,
    "end_reason",
    "walked",
    "phi_printed",
    "phi_corrected",
    "survived_fraction",
)


def simulate_trials(
    experiment: Experiment, runs: ArrayLike, gains: NDArray[np.float64]
) -> NDArray[np.void]:
    """Rows of n trials, [n], simulated at once; as `finite` gives them.

    Args:
        experiment: whose bodies, grounds and settings.
        runs: of each trial, [n].
        gains: the searched parameters of each, [n, 16 + k], in the order of
            `experiment.names`.

    Raises:
        InputError: what `taichi_nmm.simulate` refuses.
    """
    numbers, index = np.unique(np.asarray(runs, dtype=np.int64), return_inverse=True)
    different, conditions = numbers.tolist(), experiment.conditions
    searched = searched_parameters(experiment.searched)
    own, low_level = split_points(gains, searched, experiment.fixed)
    walks = taichi_nmm.simulate(
        own,
        duration_s=conditions.duration_s,
        bodies=Bodies.stacked(experiment.body(run) for run in different).take(index),
        worlds=Worlds.stacked(experiment.world(run) for run in different).take(index),
        terrains=[experiment.terrain(run) for run in different],
        terrain_index=index.astype(np.int32),
        low_level_gains=low_level if experiment.searched else None,
        settings=conditions.settings,
    )
    return finite(walks.rows)


def walked(rows: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which result rows lasted to the end and got somewhere, bool [n]."""
    return np.asarray(~fell(rows) & (rows["mean_speed_mps"] >= WALKING_SPEED_MPS))


def fell(rows: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which result rows did not last to the end (fallen or diverged), bool [n]."""
    return np.asarray(rows["end_reason"] != COMPLETED)


def finite(rows: NDArray[np.void]) -> NDArray[np.void]:
    """The rows with zero where a walker that diverged left no number, [n].

    Samplers never see a trial of no value, and a table of results has no gaps.
    """
    clean = rows.copy()
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "f":
            clean[name] = np.nan_to_num(rows[name], nan=0.0, posinf=0.0, neginf=0.0)
    return clean


def attributes(rows: NDArray[np.void]) -> dict[str, Any]:
    """`ATTRIBUTES` of one result row, [1], as plain values."""
    columns = {
        "walked": walked(rows),
        "end_reason": np.array(END_REASONS)[rows["end_reason"]],
    }
    found = {
        name: columns[name] if name in columns else rows[name] for name in ATTRIBUTES
    }
    return {name: values[0].item() for name, values in found.items()}


def row_text(row: np.void) -> str:
    """How the walk of a result row ended, in words."""
    shown = {name: row[name] for name in MEASURES}
    return outcome_text(shown | {"end_reason": END_REASONS[row["end_reason"]]})


def outcome_text(shown: Mapping[str, Any]) -> str:
    """How a walk ended, in words: from end_reason, duration_s, distance_m and mean_speed_mps."""
    reason = shown["end_reason"]
    how = "walked" if reason == END_REASONS[COMPLETED] else f"{reason} after"
    reached = f"{shown['duration_s']:.1f} s, {shown['distance_m']:.1f} m"
    return f"{how} {reached} at {shown['mean_speed_mps']:.2f} m/s"


def best_trial(objective: Objective, study: optuna.Study) -> FrozenTrial:
    """The trial of the least cost; with two goals, that which alone dominates the largest area."""
    finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return min(finished, key=lambda trial: objective.best(np.array([trial.values])))


def best_cost(objective: Objective, study: optuna.Study) -> float:
    """What the finished trials of a study have reached together: `Objective.best`."""
    if not objective.goals:
        return study.best_value
    finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return objective.best(np.array([trial.values for trial in finished]))


def progress_line(
    objective: Objective, study: optuna.Study, trial: FrozenTrial, trials: int
) -> str:
    """One finished trial, and the best so far."""
    known = study_facts(objective, study)
    names, best = (
        (objective.metrics, "front cost") if objective.goals else (["cost"], "best")
    )
    costs = "  ".join(
        f"{name} {cost:8.4f}" for name, cost in zip(names, trial.values, strict=True)
    )
    return (
        f"{known['study']}  {known['trials']:>{len(str(trials))}}/{trials}  "
        f"{costs}  {outcome_text(trial.user_attrs):<44}  "
        f"{best} {known['best_cost']:.4f} (trial {known['best_trial']})"
    )


def study_line(objective: Objective, study: optuna.Study) -> str:
    """A study in one line: how many trials walked, and the best."""
    known = study_facts(objective, study)
    scored = "" if known["score"] is None else f", score {known['score']:.1f}"
    row = "" if known["row"] is None else f" (row {known['row']}{scored})"
    costs = "".join(
        f"{name} {cost:.4f}, " for name, cost in known.get("goals", {}).items()
    )
    costs += f"{'front cost' if costs else 'cost'} {known['best_cost']:.4f}"
    first = f", the first in trial {known['first_walker']}" if known["walkers"] else ""
    return (
        f"{known['study']}: {known['walkers']} of {known['trials']} trials walked{first}; "
        f"best trial {known['best_trial']}{row}: {costs}, {outcome_text(known)}"
    )


def study_facts(objective: Objective, study: optuna.Study) -> dict[str, Any]:
    """A study with a finished trial, and its best trial, as plain values."""
    finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    walkers = [trial.number for trial in finished if trial.user_attrs["walked"]]
    best = best_trial(objective, study)
    goals = (
        dict(zip(objective.metrics, best.values, strict=True))
        if objective.goals
        else {}
    )
    return {
        "study": study.study_name,
        "trials": len(finished),
        "walkers": len(walkers),
        "first_walker": walkers[0] if walkers else None,
        "best_trial": best.number,
        "best_cost": best_cost(objective, study),
        "row": best.user_attrs.get(ROW_ATTRIBUTE),
        "score": best.user_attrs.get(
            SCORE_ATTRIBUTE
        ),  # of arms that compare rows by one number
        **{name: best.user_attrs[name] for name in (*MEASURES, "end_reason")},
        **({"goals": goals} if goals else {}),
    }
