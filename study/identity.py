"""A study remembers what it was made with, so that nothing else is ever mixed into it."""

from typing import Any

import optuna

from study.config import StudyConfig
from study.feature_table import FeatureTable
from taichi_nmm.errors import InputError

IDENTITY_ATTRIBUTE = "config"


def check_identity(
    study: optuna.Study, config: StudyConfig, arm: str, table: FeatureTable | None
) -> None:
    """Write the configuration into a new study; refuse a study made with another one.

    Raises:
        InputError: naming the study, the first setting that differs, and the value it has there.
    """
    name, identity = study.study_name, _identity(config, arm, table)
    known = study.user_attrs.get(IDENTITY_ATTRIBUTE)
    if known is None:
        if study.get_trials(deepcopy=False):
            raise InputError("study", name, "a name that no study of another program has")
        study.set_user_attr(IDENTITY_ATTRIBUTE, identity)
    elif known != identity:
        key = next(key for key in [*identity, *known] if known.get(key) != identity.get(key))
        raise InputError(
            f"study {name}: {key}",
            identity.get(key),
            f"{known.get(key)!r}, with which it was made; or another name, or another database",
        )


def _identity(config: StudyConfig, arm: str, table: FeatureTable | None) -> dict[str, Any]:
    identity: dict[str, Any] = config.identity()
    if arm == "best" and table is not None:
        identity |= {"best.store": table.digest[:16]}
    if arm == "dog" and table is not None:
        identity |= {
            "dog.store": table.digest[:16],
            "dog.score": config.score,
            "dog.startup_trials": config.startup_trials,
        }
    return identity
