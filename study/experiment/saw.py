"""What an arm's store had seen of the world before the first trial, in words."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from storage.store import Store, open_store
from study.experiment.arms import Arm
from study.features.store_features import survivals
from taichi_nmm.errors import InputError

NOTHING = "nothing but its own trials"


def saw(arm: Arm, stores: Mapping[str, Path]) -> str:
    """The settings that an arm's features were computed on.

    Args:
        arm: whose features.
        stores: folders of stores by key. Of a store that is not there, or cannot be read, only
            what the arm asks of it is known: the names of its families.
    """
    if not arm.store:
        return NOTHING
    try:
        return _of_store(arm, open_store(stores[arm.store]))
    except (KeyError, InputError):
        asked = [
            name for survival in survivals(arm.features) for name in survival.families or ("all",)
        ]
        names = ", ".join(dict.fromkeys(asked))
        return f"base setting of the store {arm.store}{f'; its families: {names}' * bool(names)}"


def _of_store(arm: Arm, store: Store) -> str:
    specification = store.specification
    known = {"robust": specification.get("robust"), **specification.get("families", {})}
    read = {
        name: known[name] for each in survivals(arm.features) for name in each.families_of(store)
    }
    by_body: dict[str, list[str]] = {}
    for setting in (specification, *read.values()):
        by_body.setdefault(_body(setting), []).append(_ground(setting))
    return "; ".join(f"{body}: {'; '.join(grounds)}" for body, grounds in by_body.items())


def _ground(setting: dict[str, Any]) -> str:
    name = str(setting["terrain"]["name"])
    return "level ground" if name == "flat" else name


def _body(setting: dict[str, Any]) -> str:
    percent = 100.0 * setting["body"]["disturbance"]
    body = f"bodies disturbed by {percent:g} %" if percent else "undisturbed body"
    return f"{body}, in worlds that differ" if "world" in setting else body
