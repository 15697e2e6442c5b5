"""A trial as rows of Optuna's tables."""

import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import cache
from typing import Any

from optuna.distributions import distribution_to_json
from optuna.trial import FrozenTrial

Row = dict[str, Any]
as_json = cache(distribution_to_json)


def rows_of(trial: FrozenTrial) -> Iterator[tuple[str, Row]]:
    """All that a trial has, row by row, each with the name of its table; the trial's id is not."""
    for objective, value in enumerate(trial.values or ()):
        kind = {math.inf: "INF_POS", -math.inf: "INF_NEG"}.get(value, "FINITE")
        stored = value if kind == "FINITE" else None
        yield (
            "trial_values",
            {"objective": objective, "value": stored, "value_type": kind},
        )
    for name, distribution in trial.distributions.items():
        value = distribution.to_internal_repr(trial.params[name])
        about = {"param_value": value, "distribution_json": as_json(distribution)}
        yield "trial_params", {"param_name": name, **about}
    for owner in ("user", "system"):
        for attribute in attribute_rows(getattr(trial, f"{owner}_attrs")):
            yield f"trial_{owner}_attributes", attribute


def attribute_rows(values: dict[str, Any]) -> list[Row]:
    """Attributes, JSON values, by key."""
    return [
        {"key": key, "value_json": json.dumps(value)} for key, value in values.items()
    ]


def naive_utc(local: datetime) -> datetime:
    """A time of this machine as Optuna keeps it."""
    return local.astimezone(UTC).replace(tzinfo=None)
