"""What a comparison says at its end: a line an arm."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from study.comparison.arms import ARMS
from study.comparison.notes import ArmCurves, arm_curves
from study.comparison.saw import saw


@dataclass(frozen=True)
class ArmSummary:
    """What an arm has come to.

    Attributes:
        arm: its name.
        saw: which settings its store saw.
        runs: that have trials.
        trials: of all its runs.
        walkers: runs with a trial that walked.
        first_walker: median over runs of the trials until the first walker (1 is the first trial);
            None where fewer than half the runs have one.
        best_cost: median over runs of the best cost.
        proposal_ms: mean time that the sampler took for a trial.
    """

    arm: str
    saw: str
    runs: int
    trials: int
    walkers: int
    first_walker: float | None
    best_cost: float
    proposal_ms: float


def summaries(trials: pa.Table, times: pa.Table, stores: Mapping[str, Path]) -> list[ArmSummary]:
    """Of each arm of a table of results, in the order of their names.

    Args:
        trials: `RESULT_SCHEMA`.
        times: proposal times.
        stores: folders of the experiment's, by key.
    """
    arm, seconds = np.asarray(times["arm"]), np.asarray(times["proposal_s"])
    return [
        _summary(curves, stores, float(seconds[arm == curves.arm].mean()))
        for curves in arm_curves(trials)
    ]


def _summary(curves: ArmCurves, stores: Mapping[str, Path], proposal_s: float) -> ArmSummary:
    first = curves.first_walker
    median = float(np.median(first))
    return ArmSummary(
        arm=curves.arm,
        saw=saw(ARMS[curves.arm], stores) if curves.arm in ARMS else "",
        runs=len(first),
        trials=int(np.isfinite(curves.best_cost).sum()),
        walkers=int(np.isfinite(first).sum()),
        first_walker=median if np.isfinite(median) else None,
        best_cost=float(np.median(np.nanmin(curves.best_cost, axis=1))),
        proposal_ms=1e3 * proposal_s,
    )


def as_text(found: list[ArmSummary]) -> str:
    """A table for people."""
    lines = [
        "arm                runs  with a walker  first (median)  best cost (median)  ms a trial"
    ]
    for one in found:
        first = (
            f"> {one.trials // one.runs}" if one.first_walker is None else f"{one.first_walker:g}"
        )
        lines.append(
            f"{one.arm:<18} {one.runs:>4}  {one.walkers:>13}  {first:>14}"
            f"  {one.best_cost:>18.4f}  {one.proposal_ms:>10.1f}"
        )
    return "\n".join(lines)


def as_documents(found: list[ArmSummary]) -> list[dict[str, Any]]:
    """The same for programs."""
    return [asdict(one) for one in found]
