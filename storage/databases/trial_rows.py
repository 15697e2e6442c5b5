"""A trial as the rows of Optuna's tables."""

import json
import math
from datetime import UTC, datetime
from functools import cache
from typing import Any

from optuna.distributions import BaseDistribution, distribution_to_json
from optuna.trial import FrozenTrial

Rows = list[dict[str, Any]]
Owned = list[tuple[int, FrozenTrial]]
"""Trials with their ids in the database."""


def trial_row(study_id: int, number: int, trial: FrozenTrial) -> dict[str, Any]:
    """The trial itself.

    Raises:
        ValueError: it is not finished, or has intermediate values.
    """
    if not trial.state.is_finished() or trial.intermediate_values:
        raise ValueError(f"trial {number}: not finished, or with intermediate values")
    return {
        "study_id": study_id,
        "number": number,
        "state": trial.state.name,
        "datetime_start": _naive_utc(trial.datetime_start),
        "datetime_complete": _naive_utc(trial.datetime_complete),
    }


def value_row(trial_id: int, trial: FrozenTrial) -> dict[str, Any]:
    """Its one value, which it must have."""
    assert trial.value is not None
    if math.isfinite(trial.value):
        stored, kind = trial.value, "FINITE"
    else:
        stored, kind = None, "INF_POS" if trial.value > 0 else "INF_NEG"
    return {"trial_id": trial_id, "objective": 0, "value": stored, "value_type": kind}


def parameter_rows(owned: Owned) -> Rows:
    """A row a parameter."""
    return [
        {
            "trial_id": trial_id,
            "param_name": name,
            "param_value": distribution.to_internal_repr(trial.params[name]),
            "distribution_json": _as_json(distribution),
        }
        for trial_id, trial in owned
        for name, distribution in trial.distributions.items()
    ]


def attribute_rows(owned: Owned, kind: str) -> Rows:
    """A row an attribute; `kind` is "user" or "system"."""
    return [
        {"trial_id": trial_id, "key": key, "value_json": json.dumps(value)}
        for trial_id, trial in owned
        for key, value in getattr(trial, f"{kind}_attrs").items()
    ]


def _naive_utc(local: datetime | None) -> datetime | None:
    return None if local is None else local.astimezone(UTC).replace(tzinfo=None)


@cache
def _as_json(distribution: BaseDistribution) -> str:
    return distribution_to_json(distribution)
