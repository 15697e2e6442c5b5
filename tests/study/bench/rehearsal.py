"""The bench with the walker for a machine, whose ground changes after some trials.

    python -m tests.study.bench.rehearsal --robots 20 --seed 3301 --after risers

On each robot the bench goes on in a new context; beside it one that is begun anew, and one that
carries on as if nothing had changed. Prints the median of the least cost after 1, 3 and 10 trials
on the new ground, and on how many robots the context is ahead of the others. Needs the store
out/store-worlds (`taichi-nmm precompute --config store-worlds`).

The bench with contexts is entered from three computers in turn, each of which opens it anew, and
with mistakes: trials that break off, wrong numbers that are corrected, trials that are undone. In
the end a quiet bench must have proposed the same for the same results.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np
import optuna

from study.bench.bench import Bench
from study.bench.journal import Trial
from study.experiment.experiment import Experiment, read_experiment
from study.experiment.trials import costs, finite, simulate_trials
from study.options import config_path
from study.report.numbers import wilcoxon

TRIALS, AFTER = 20, (1, 3, 10)
MISTAKE = 0.15  # chance of each kind, a trial
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
        found.append(tried(experiment, robot, trial))
        bench.record(trial.number, found[-1])
    return found


def tried(experiment: Experiment, robot: int, trial: Trial) -> float:
    """The cost that a trial shows."""
    gains = np.array([[trial.params[name] for name in experiment.names]])
    rows = finite(simulate_trials(experiment, [robot], gains).rows)
    return float(costs(rows, experiment.cost)[0])


def clumsily(
    path: Path, experiment: Experiment, robot: int, trials: int, rng: np.random.Generator
) -> list[float]:
    """The same from three computers, with mistakes that are put right."""
    found = []
    for turn in range(trials):
        bench = Bench(path, f"computer {turn % 3}")
        (trial,) = bench.next()
        if rng.random() < MISTAKE:
            bench.abort(trial.number, "a cable")
            (trial,) = bench.next()
        if rng.random() < MISTAKE:
            bench.add([(trial.params, 1e3, {}, "another machine's")])
            bench.undo()
        found.append(tried(experiment, robot, trial))
        wrong = rng.random() < MISTAKE
        bench.record(trial.number, 1e3 * found[-1] if wrong else found[-1])
        if wrong:
            bench.correct(trial.number, found[-1])
    return found


def assert_same_as_quiet(clumsy: Path, quiet: Path) -> None:
    """Give a quiet bench the results of the other one: it must ask for the same trials."""
    told, bench, context = Bench(clumsy).state.trials.values(), Bench.new(quiet), ""
    for trial in told:
        if trial.context != context:
            bench.context(context := trial.context)
        (asked,) = bench.next()
        assert asked.params == trial.params
        bench.record(asked.number, trial.value)


def rehearse(folder: Path, robot: int, before: Experiment, after: Experiment) -> np.ndarray:
    """Least costs after some trials on the new ground, [ways, len(AFTER)]."""
    store, rng = Path("out/store-worlds").absolute(), np.random.default_rng(robot)
    for way in (*WAYS[:2], "quiet"):
        (folder / way).mkdir(parents=True)
        text = TOML.format(store=store, success=before.success)
        (folder / way / "bench.toml").write_text(text)
    path = folder / "context" / "bench.toml"
    first = Bench.new(path)
    clumsily(path, before, robot, TRIALS, rng)
    shutil.copytree(folder / "context", folder / "carry on")
    first.context("new ground")
    found = [clumsily(path, after, robot, AFTER[-1], rng)]
    assert_same_as_quiet(path, folder / "quiet" / "bench.toml")
    for way in WAYS[1:]:
        found.append(run(Bench.new(folder / way / "bench.toml"), after, robot, AFTER[-1]))
    return np.minimum.accumulate(found, axis=1)[:, np.array(AFTER) - 1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--seed", type=int, default=3301)
    parser.add_argument("--before", default="rough8-smooth")
    parser.add_argument("--after", default="risers")
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    before, after = (
        read_experiment(config_path(name), None, args.seed).on_one_thread()
        for name in (args.before, args.after)
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
