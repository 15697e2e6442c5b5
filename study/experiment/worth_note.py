"""What the features of a study's arm were worth, as the study's note in the dashboard."""

import optuna

from study.experiment.arms import Arm
from study.experiment.experiment import Experiment
from study.experiment.one_study import sampler_seed
from study.experiment.task import Task
from study.sampler.diagnostics import TITLE, Worth
from study.sampler.feature_sampler import FeatureKernelSampler


def worth_of_study(experiment: Experiment, arm: Arm, run: int, study: optuna.Study) -> Worth | None:
    """The worth of the arm's features in the trials of its study; None: it follows none."""
    if not arm.features:
        return None
    seed = sampler_seed(experiment.seed, arm.name, run)
    sampler = arm.new_sampler(Task(experiment, seed, 0, arm.store, arm.features))
    if not isinstance(sampler, FeatureKernelSampler) or not sampler.has_features:
        return None
    return sampler.worth(study)


def note_worth(experiment: Experiment, arm: Arm, run: int, study: optuna.Study) -> None:
    """Show it with the study, in place of an earlier one; a note of the user's stays."""
    worth = worth_of_study(experiment, arm, run, study)
    if worth is None:
        return
    from optuna_dashboard import get_note, save_note  # a second, which other studies need not spend

    known, note = get_note(study), worth.markdown()
    if note != known and (not known or known.startswith(f"## {TITLE}")):
        save_note(study, note)
