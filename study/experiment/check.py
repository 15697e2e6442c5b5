"""What is refused before any work is done or any file is touched."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from study.experiment.arms import Arm, find_arm
from study.experiment.experiment import Experiment
from study.experiment.stores import candidates, check_store
from taichi_nmm.errors import InputError


def check_arms(experiment: Experiment, names: Sequence[str], trials: int) -> tuple[Arm, ...]:
    """The arms of these names, each found able to run `trials` trials of the experiment.

    Raises:
        InputError: no arm at all, an unknown one, or one whose store is missing, of other
            parameters, without a feature, or with fewer rows than trials.
    """
    if not names:
        raise InputError("arms", "none", "one arm or more, in the configuration or by --arms")
    arms = tuple(find_arm(name) for name in dict.fromkeys(names))
    for arm in arms:
        _check(experiment, arm, trials)
    return arms


def _check(experiment: Experiment, arm: Arm, trials: int) -> None:
    if not arm.store:
        return
    store = check_store(experiment, arm.store, arm.features)
    rows = int(candidates(experiment, arm.store, arm.features).rows.offered.sum())
    if trials > rows:
        allowed = f"at most {rows}, the rows that {arm.name} may take of the store {store.path}"
        raise InputError("trials", trials, allowed)


def with_store(experiment: Experiment, names: Sequence[str], path: Path) -> Experiment:
    """The experiment with a store of the caller's, in place of the one that the arms read.

    Raises:
        InputError: an unknown arm, or arms that read no store or several.
    """
    read = sorted({arm.store for arm in map(find_arm, names) if arm.store})
    if len(read) != 1:
        found = f"{', '.join(names)}: {' and '.join(read) or 'none'}"
        raise InputError("store", str(path), f"with arms that read one store; {found}")
    return replace(experiment, stores={**experiment.stores, read[0]: path})
