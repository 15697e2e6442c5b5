"""What a comparison says at its end: a line an arm."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from study.comparison.arms import ARMS
from study.comparison.saw import saw

_READ = ("run", "trial", "walked", "best_cost")


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
        trials: `RESULT_SCHEMA`, sorted by arm, run and trial.
        times: proposal times, in the same order.
        stores: folders of the experiment's, by key.
    """
    arm = trials["arm"].to_numpy(zero_copy_only=False)
    columns = {name: trials[name].to_numpy(zero_copy_only=False) for name in _READ}
    seconds = times["proposal_s"].to_numpy()
    found = []
    for name in dict.fromkeys(arm.tolist()):
        mine = arm == name
        part = {column: values[mine] for column, values in columns.items()}
        seen = saw(ARMS[name], stores) if name in ARMS else ""
        found.append(_summary(name, seen, part, float(seconds[mine].mean())))
    return found


def _summary(name: str, seen: str, columns: dict[str, Any], proposal_s: float) -> ArmSummary:
    runs, last = np.unique(columns["run"][::-1], return_index=True)
    best = columns["best_cost"][::-1][last]  # sorted by trial: the first from behind is the last
    first = np.full(len(runs), np.inf)
    walked = columns["walked"].astype(bool)
    place = np.searchsorted(runs, columns["run"][walked])
    np.minimum.at(first, place, columns["trial"][walked] + 1.0)
    median = float(np.sort(first)[(len(first) - 1) // 2 : len(first) // 2 + 1].mean())
    return ArmSummary(
        arm=name,
        saw=seen,
        runs=len(runs),
        trials=len(columns["run"]),
        walkers=int(np.isfinite(first).sum()),
        first_walker=median if np.isfinite(median) else None,
        best_cost=float(np.median(best)),
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
