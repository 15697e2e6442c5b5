"""Made-up results: a folder of realistic shape (70,000 rows in a second), and runs to count."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from study.report.runs import ArmRuns, Results

Chances = dict[str, tuple[float, float]]
# Of each arm: how likely a trial walks at first, and how much likelier with every
# trial.
ARMS = {
    "random": (0.004, 0.0),
    "cmaes-cold": (0.005, 0.0004),
    "cmaes-warm": (0.02, 0.0006),
    "bo-euclidean": (0.006, 0.0003),
    "tpe": (0.006, 0.0005),
    "dog": (0.02, 0.002),
    "worlds-stairs": (0.015, 0.003),
    "worlds": (0.4, 0.01),
    "ranking": (0.4, 0.0),
}


def columns(arms, runs, trials, cost):
    """The columns of trials.parquet that a report reads, sorted by arm, run, trial."""
    rng = np.random.default_rng(0)
    n = len(arms) * runs * trials
    arm = np.repeat(sorted(arms), runs * trials)
    run = np.tile(np.repeat(np.arange(runs, dtype=np.int32), trials), len(arms))
    trial = np.tile(np.arange(trials, dtype=np.int32), len(arms) * runs)
    luck = rng.uniform(0.3, 1.7, runs)[run]  # of the run, shared by its arms
    first, slope = np.array([arms[name] for name in arm]).T
    chance = luck * np.minimum(first + slope * trial, 0.9)
    completed = (rng.random(n) < chance) | (first >= 1.0)
    least, walks, most = (0.012, 0.03, 0.8) if cost == "smooth" else (4.0, 80.0, 300.0)
    value = np.where(
        completed, rng.uniform(least, walks, n), rng.uniform(walks, most, n)
    )
    best = np.minimum.accumulate(value.reshape(-1, trials), axis=1).ravel()
    return {
        "experiment": np.full(n, "made-up"),
        "arm": arm,
        "run": run,
        "trial": trial,
        "cost": value,
        "best_cost": best,
        "walked": completed,
    }


def write(folder, arms=ARMS, runs=50, trials=100, cost="smooth", name="made-up"):
    """Such a folder: trials.parquet and experiment.json."""
    folder.mkdir(parents=True, exist_ok=True)
    made = columns(arms, runs, trials, cost)
    made["experiment"] = np.full(len(made["arm"]), name)
    pq.write_table(pa.table(made), folder / "trials.parquet")
    document = {"name": name, "seed": 1, "objective": {"cost": cost}}
    (folder / "experiment.json").write_text(json.dumps(document))
    return folder


def arm(name, first, cost=1.0, trials=40):
    """Runs whose first walker is at these trials; each costs less the later it is seen."""
    walks = np.zeros((len(first), trials), bool)
    for run, trial in enumerate(first):
        if np.isfinite(trial):
            walks[run, int(trial) - 1 :] = True
    best = cost + np.arange(len(first))[:, None] + np.linspace(1.0, 0.0, trials)
    return ArmRuns(name, np.arange(len(first)), best, walks, walks.size)


def counted(*arms, name="counted"):
    """An experiment of these arms."""
    return Results(Path(), name, "smooth", {each.arm: each for each in arms}, {})
