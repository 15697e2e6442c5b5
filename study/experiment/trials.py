"""Words and numbers about the trials of a study: its best, and how far it is."""

from typing import Any

import numpy as np
import optuna
from optuna.trial import FrozenTrial

from study.experiment.experiment import WALKED, Experiment
from study.experiment.objective import Objective
from study.experiment.one_study import best_cost, finished_trials
from study.sampler.history import ROW_ATTRIBUTE, SCORE_ATTRIBUTE


def best_trial(objective: Objective, study: optuna.Study) -> FrozenTrial:
    """The trial of the least cost; with two goals, that which alone dominates the largest area."""
    return min(
        finished_trials(study),
        key=lambda trial: objective.best(np.array([trial.values])),
    )


def progress_line(
    experiment: Experiment, study: optuna.Study, trial: FrozenTrial, trials: int
) -> str:
    """One finished trial, and the best so far."""
    objective, known = experiment.objective, study_facts(experiment, study)
    names, best = (
        (objective.metrics, "front cost") if objective.goals else (["cost"], "best")
    )
    costs = "  ".join(
        f"{name} {cost:8.4f}" for name, cost in zip(names, trial.values, strict=True)
    )
    return (
        f"{known['study']}  {known['trials']:>{len(str(trials))}}/{trials}  "
        f"{costs}  {experiment.outcome_text(trial.user_attrs):<44}  "
        f"{best} {known['best_cost']:.4f} (trial number {known['best_trial']})"
    )


def study_line(experiment: Experiment, study: optuna.Study) -> str:
    """A study in one line: how many trials walked, and the best."""
    known = study_facts(experiment, study)
    scored = "" if known["score"] is None else f", score {known['score']:.1f}"
    row = "" if known["row"] is None else f" (row {known['row']}{scored})"
    costs = "".join(
        f"{name} {cost:.4f}, " for name, cost in known.get("goals", {}).items()
    )
    costs += f"{'front cost' if costs else 'cost'} {known['best_cost']:.4f}"
    first = f", the first after {known['first_walker']}" if known["walkers"] else ""
    return (
        f"{known['study']}: {known['walkers']} of {known['trials']} trials walked{first}; "
        f"best: trial number {known['best_trial']}{row}: {costs}, {experiment.outcome_text(known)}"
    )


def study_facts(experiment: Experiment, study: optuna.Study) -> dict[str, Any]:
    """A study with a finished trial, and its best trial, as plain values.

    "best_trial" is Optuna's number, from 0; "first_walker" counts finished trials, the
    walker's among them; None: no trial walked.
    """
    objective, finished = experiment.objective, finished_trials(study)
    walked = [trial.user_attrs[WALKED] for trial in finished]
    best = best_trial(objective, study)
    goals = (
        dict(zip(objective.metrics, best.values, strict=True))
        if objective.goals
        else {}
    )
    return {
        "study": study.study_name,
        "trials": len(finished),
        "walkers": sum(walked),
        "first_walker": walked.index(True) + 1 if any(walked) else None,
        "best_trial": best.number,
        "best_cost": best_cost(experiment, study),
        "row": best.user_attrs.get(ROW_ATTRIBUTE),
        "score": best.user_attrs.get(
            SCORE_ATTRIBUTE
        ),  # of arms that compare rows by one number
        **{name: best.user_attrs[name] for name in experiment.measures},
        **({"goals": goals} if goals else {}),
    }
