"""What a comparison prints at its end: a line an arm, for people or for programs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from study.experiment.arms import ARMS, saw
from study.report.numbers import ArmNumbers, Numbers
from study.report.words import count_text

HEADER = "arm                runs  with a walker  first (median)  best cost (median)  ms a trial"


def arms_text(numbers: Numbers) -> str:
    """A table of the arms, in the order of their names."""
    return "\n".join([HEADER, *map(_line, _by_name(numbers))])


def arms_documents(numbers: Numbers, stores: Mapping[str, Path]) -> list[dict[str, Any]]:
    """The same as plain values; a first walker that most runs lack is None.

    Args:
        numbers: of the comparison.
        stores: folders of the experiment's stores, by key.
    """
    return [_document(arm, stores) for arm in _by_name(numbers)]


def _by_name(numbers: Numbers) -> list[ArmNumbers]:
    return sorted(numbers.arms, key=lambda arm: arm.arm)


def _line(arm: ArmNumbers) -> str:
    first = count_text(arm.first_walker.value, arm.trials)
    time = "-" if arm.proposal_ms is None else f"{arm.proposal_ms:.1f}"
    return (
        f"{arm.arm:<18} {arm.runs:>4}  {arm.walkers:>13}  {first:>14}"
        f"  {arm.best_cost.value:>18.4f}  {time:>10}"
    )


def _document(arm: ArmNumbers, stores: Mapping[str, Path]) -> dict[str, Any]:
    first = arm.first_walker.value
    return {
        "arm": arm.arm,
        "saw": saw(ARMS[arm.arm], stores) if arm.arm in ARMS else "",
        "runs": arm.runs,
        "trials": arm.found,
        "walkers": arm.walkers,
        "first_walker": first if np.isfinite(first) else None,
        "best_cost": arm.best_cost.value,
        "proposal_ms": arm.proposal_ms,
    }
