"""The bench with the walker for a machine, whose ground changes after some trials.

    python -m tests.study.bench.rehearsal --robots 20 --seed 3301 --after risers

On each robot the bench goes on in a new context; beside it one that is begun anew, and one that
carries on as if nothing had changed. Prints the median of the least cost after 1, 3 and 10 trials
on the new ground, and on how many robots the context is ahead of the others. Needs the store
out/store-worlds (`taichi-nmm precompute --config store-worlds`).
"""

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np
import optuna

from study.bench.bench import Bench
from study.experiment.experiment import Experiment, read_experiment
from study.experiment.trials import costs, finite, simulate_trials
from study.options import config_path
from study.report.numbers import wilcoxon

TRIALS, AFTER = 20, (1, 3, 10)
WAYS = ("context", "new", "carry on")
TOML = """
name = "rehearsal"
[candidates]
store = "{store}"
[goal]
success = {success}
"""


def run(bench: Bench, experiment: Experiment, robot: int, trials: int) -> list[float]:
    """Costs of the next trials on a robot of an experiment."""
    found = []
    for _ in range(trials):
        (trial,) = bench.next()
        gains = np.array([[trial.params[name] for name in experiment.names]])
        rows = finite(simulate_trials(experiment, [robot], gains).rows)
        found.append(float(costs(rows, experiment.cost)[0]))
        bench.record(trial.number, found[-1])
    return found


def rehearse(folder: Path, robot: int, before: Experiment, after: Experiment) -> np.ndarray:
    """Least costs after some trials on the new ground, [ways, len(AFTER)]."""
    store = Path("out/store-worlds").absolute()
    benches = dict.fromkeys(WAYS[:2])
    for way in benches:
        (folder / way).mkdir(parents=True)
        text = TOML.format(store=store, success=before.success)
        (folder / way / "bench.toml").write_text(text)
    first = Bench.new(folder / "context" / "bench.toml")
    run(first, before, robot, TRIALS)
    shutil.copytree(folder / "context", folder / "carry on")
    first.context("new ground")
    found = []
    for way in WAYS:
        bench = Bench.new(folder / way / "bench.toml")
        told = np.minimum.accumulate(run(bench, after, robot, AFTER[-1]))
        found.append([told[at - 1] for at in AFTER])
    return np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--seed", type=int, default=3301)
    parser.add_argument("--before", default="rough8-smooth")
    parser.add_argument("--after", default="risers")
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    before, after = (
        read_experiment(config_path(name), None, args.seed) for name in (args.before, args.after)
    )
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for robot in range(args.robots):
            found.append(rehearse(Path(folder, str(robot)), robot, before, after))
            print(robot, np.round(found[-1], 5).tolist(), flush=True)
    costs_of = np.array(found)  # [robots, ways, after]
    for way, name in enumerate(WAYS):
        print(f"{name:<9} median of the least cost:", *np.median(costs_of[:, way], axis=0).round(5))
        for place, at in enumerate(AFTER) if way else ():
            ours, other = costs_of[:, 0, place], costs_of[:, way, place]
            won, lost = int((ours < other).sum()), int((ours > other).sum())
            print(f"  context, after {at}: won {won}, lost {lost}, p {wilcoxon(ours, other).p:.2g}")


if __name__ == "__main__":
    main()
