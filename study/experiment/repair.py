"""A repair: a short study on one walker, ground and body, of which each call runs a trial.

So a process that dies loses one trial, others have their turn between two of them, and
whoever asks again, of the same walker, goes on.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import optuna

from storage.databases.studies import only_run, open_studies, storage_errors
from storage.databases.urls import file_url
from storage.store import Store
from storage.tables import document_hash
from study.experiment.arms import OUR_ARM, PAPER_ARM, PRINTED, check_arms, find_arm
from study.experiment.experiment import study_name
from study.experiment.folder import document
from study.experiment.gains import NamedGains, named_gains
from study.experiment.live_study import check_study, open_study, run_trials
from study.experiment.one_study import finished_trials
from study.experiment.trials import best_trial, study_facts
from study.experiment.walker import ADDED, THETA_REF, WalkerExperiment
from taichi_nmm.conditions import TRIAL_S
from taichi_nmm.parameters import DEVICE, GAIN_NAMES

TRIALS = 30
NAME = "repair"  # of the experiment
LOW_LEVEL = (THETA_REF.name, *ADDED)  # that may be searched
WITHOUT_STORE = "bo-euclidean"
DATABASE = "study.db"
DIGITS = 16  # of the digest in a folder's name


@dataclass(frozen=True, eq=False)
class Repair:
    """How far a repair has come.

    Attributes:
        trials: that are finished, at most `TRIALS`.
        best: number of the best one.
        gains: of the best one.
        words: how the best one walked.
    """

    trials: int
    best: int
    gains: NamedGains
    words: str


def repair_of(setting: WalkerExperiment, store: Store) -> tuple[WalkerExperiment, str]:
    """The experiment of a repair, and the name of its arm.

    Its robot is the last run of the setting. Searched and fixed is what the store
    searched and fixed, and searched the torque of an exoskeleton that the setting
    names. The arm learns from the worlds of the store or, where it has none, from the
    score of its rows.

    Args:
        setting: body, ground and world.
        store: the rows at hand; from trials of a study, which lie in no files of a
            store, no arm learns.
    """
    names = {*store.parameter_names}.intersection(LOW_LEVEL)
    if "exoskeleton" in setting.conditions.world_ranges.document():
        names |= {each.name for each in DEVICE}
    fixed = store.specification.get("fixed_gains", {})
    arm = PAPER_ARM if PRINTED in store.columns and not store.families else OUR_ARM
    if not store.files:
        arm = WITHOUT_STORE
    experiment = replace(
        setting,
        name=NAME,
        searched=tuple(name for name in LOW_LEVEL if name in names),
        fixed=tuple(fixed[name] for name in GAIN_NAMES) if fixed else (),
        conditions=replace(setting.conditions, duration_s=TRIAL_S),
        stores={find_arm(arm).store: store.path},
    )
    return experiment, arm


def repaired(experiment: WalkerExperiment, arm_name: str, out: Path) -> Repair:
    """One more trial, unless there are enough; and what the study has come to.

    Args:
        experiment: of `repair_of`.
        arm_name: likewise.
        out: folder in which each repair has one, by what it is of.

    Raises:
        InputError: the store does not fit the walker, or as of a live study.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    experiment = experiment.on_one_thread().with_settings(arch="cpu")
    run = experiment.runs - 1
    (arm,) = check_arms(experiment, (arm_name,), TRIALS)
    digest = document_hash(document(experiment, (arm,)))[:DIGITS]
    folder = out / f"{NAME}-{digest}"
    url = file_url(folder / DATABASE)
    check_study(experiment, arm, run, url, folder)
    storage = open_studies(url)
    with (
        only_run(url, study_name(NAME, arm.name, run)),
        storage_errors(url),
    ):
        begun = open_study(experiment, arm, run, storage)
        due = min(len(finished_trials(begun)) + 1, TRIALS)
        study = run_trials(experiment, arm, run, due, storage)
        best = best_trial(experiment.objective, study)
        known = study_facts(experiment, study)
        gains = {**experiment.fixed_by_name, **best.params}
    return Repair(
        trials=due,
        best=best.number,
        gains=named_gains(f"{NAME}, trial {best.number}", gains),
        words=experiment.outcome_text(known),
    )
