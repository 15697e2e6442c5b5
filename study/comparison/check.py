"""What is refused before any work is done or any file is touched."""

from collections.abc import Sequence

from study.comparison.arms import Arm, check_installed, find_arm
from study.comparison.experiment import Experiment
from study.comparison.off_grid import store_features
from study.comparison.stores import check_store, store_path
from taichi_nmm.errors import InputError


def check_arms(experiment: Experiment, names: Sequence[str], trials: int) -> tuple[Arm, ...]:
    """The arms of these names, each found able to run `trials` trials of the experiment.

    Raises:
        InputError: no arm at all, an unknown one, one whose library is missing, or one whose store
            is missing, of other parameters, without a feature, or with fewer rows than trials.
    """
    if not names:
        raise InputError("arms", "none", "one arm or more, in the configuration or by --arms")
    arms = tuple(find_arm(name) for name in dict.fromkeys(names))
    for arm in arms:
        check_installed(arm)
        if not arm.store:
            continue
        store = check_store(experiment, arm.store, arm.features)
        if trials > len(store):
            allowed = f"at most {len(store)}, the rows of the store {store.path}"
            raise InputError("trials", trials, allowed)
        if arm.off_grid:
            path = store_path(experiment, arm.store)
            store_features(path, arm.columns, experiment.searched)
    return arms
