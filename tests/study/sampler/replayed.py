"""Robots of a comparison, trial by trial: what would have been said, and what happened.

    taichi-nmm compare --config ant-robots --arms worlds
    python -m tests.study.sampler.replayed --config ant-robots --out out/compare/ant-robots

Before each trial but the first, the sampler predicts it from those before it. Prints how
often the 95 % interval held what the trial cost, and the chance of success that was said
beside how often it came.
"""

import argparse
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow.parquet
from optuna.exceptions import ExperimentalWarning
from optuna.trial import create_trial

from study import FeatureKernelSampler
from study.experiment.arms import OUR_ARM, find_arm
from study.experiment.robots import read_any
from study.experiment.samplers import Task
from study.options import config_path
from tests.study.sampler.campaigns import Said, said_and_happened, share


def replayed(
    task: Task, trials: Sequence[Mapping[str, Any]], success: float
) -> Iterator[Said]:
    """What was said of each trial of one robot but the first."""
    sampler = find_arm(OUR_ARM).new_sampler(task)
    assert isinstance(sampler, FeatureKernelSampler)
    study, space = optuna.create_study(sampler=sampler), task.table.rows.space.as_dict()
    for number, trial in enumerate(trials):
        params, cost = {name: trial[name] for name in space}, trial["cost"]
        if number:
            found = sampler.predict(study, [params])
            yield Said(
                kind=task.experiment.name,
                is_like=False,
                trial=number + 1,
                low=float(found.low[0]),
                high=float(found.high[0]),
                success=float(found.success[0]),
                kept=np.nan,
                value=cost,
                succeeded=cost <= success,
                has_kept=True,
                recommended=np.nan,
                unlike=bool(found.unlike),
            )
        study.add_trial(create_trial(params=params, distributions=space, value=cost))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--config", required=True)
    parser.add_argument("--out", type=Path, required=True, help="of the comparison")
    parser.add_argument("--robots", type=int, default=50)
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    warnings.simplefilter("ignore", ExperimentalWarning)
    experiment, arm = read_any(config_path(args.config), None, None), find_arm(OUR_ARM)
    success = experiment.objective.success(experiment.trial_s)
    if success is None:
        sys.exit(f"{args.config}: no success is defined")
    some = [("arm", "=", OUR_ARM), ("run", "<", args.robots)]
    ours = pyarrow.parquet.read_table(args.out / "trials.parquet", filters=some)
    task, said = Task(experiment, 0, 0, arm.store, arm.feature), list[Said]()
    in_order = ours.sort_by([("run", "ascending"), ("trial", "ascending")]).to_pylist()
    for _, trials in groupby(in_order, key=lambda trial: trial["run"]):
        said += replayed(task, [*trials], success)
    held = [each.low <= each.value <= each.high for each in said]
    print(f"The 95 % interval held the next reading: {share(held)} of {len(held)}")
    print("\n".join(said_and_happened("Success", said, "success", "succeeded")))


if __name__ == "__main__":
    main()
