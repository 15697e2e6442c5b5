"""The bench with a simulated robot for a machine, whose ground changes after some trials.

    python -m tests.study.bench.rehearsal --robots 20 --seed 3301 --after risers

On each robot the bench goes on in a new context; beside it one that is begun anew, and
one that carries on as if nothing had changed. Prints the median of the least cost after
1, 3 and 10 trials on the new ground, and on how many robots the context is ahead of the
others. Needs the store of the configuration, out/store-worlds
(`taichi-nmm precompute --config store-worlds`).

The bench with contexts is entered from three computers in turn, each of which opens it
anew, and with mistakes: trials that break off, wrong numbers that are corrected, trials
that are undone. In the end a quiet bench must have proposed the same for the same
results.
"""

import argparse
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import optuna

from study.bench.bench import Bench
from study.bench.journal import Trial
from study.experiment.experiment import store_path
from study.experiment.walker import read_experiment
from study.options import config_path
from study.report.numbers import wilcoxon

TRIALS, AFTER = 20, (1, 3, 10)
MISTAKE = 0.15  # chance of each kind, a trial
WAYS = ("context", "new", "carry on")
TOML = """
name = "rehearsal"
[candidates]
store = "{store}"
cost = "{cost}"
[goal]
success = {success}
"""


@dataclass(frozen=True)
class Machine:
    """Robots on one kind of ground, and the file of a bench for them."""

    toml: str
    cost: Callable[[int, Trial], float]  # of a trial on a robot

    @classmethod
    def of(cls, config, seed):
        """The walkers of a configuration of `compare`."""
        walkers = read_experiment(config_path(config), None, seed).on_one_thread()
        toml = TOML.format(
            store=store_path(walkers, "worlds").absolute(),
            cost=walkers.objective.cost,
            success=walkers.objective.success(walkers.trial_s),
        )
        return cls(toml, partial(cost_of, walkers))


def cost_of(experiment, robot, trial):
    """What a trial on a robot costs, without noise."""
    point = [trial.params[name] for name in experiment.space]
    rows = experiment.simulate([robot], np.array([point]))
    return float(experiment.objective.costs(rows)[0])


def run(bench, machine, robot, trials):
    """Costs of the next trials on a robot."""
    found = []
    for _ in range(trials):
        (trial,) = bench.next()
        found.append(machine.cost(robot, trial))
        bench.record(trial.number, found[-1])
    return found


def clumsily(path, machine, robot, trials, rng):
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
        found.append(machine.cost(robot, trial))
        wrong = rng.random() < MISTAKE
        bench.record(trial.number, 1e3 * found[-1] if wrong else found[-1])
        if wrong:
            bench.correct(trial.number, found[-1])
    return found


def assert_same_as_quiet(clumsy, quiet):
    """Give a quiet bench the results of the other one: it must ask for the same trials."""
    told, bench, context = Bench(clumsy).state.trials.values(), Bench.new(quiet), ""
    for trial in told:
        if trial.context != context:
            bench.context(context := trial.context)
        (asked,) = bench.next()
        assert asked.params == trial.params
        bench.record(asked.number, trial.value)


def rehearse(folder, robot, before, after):
    """Least costs after some trials on the new ground, [ways, len(AFTER)]."""
    rng = np.random.default_rng(robot)
    for way in (*WAYS[:2], "quiet"):
        (folder / way).mkdir(parents=True)
        (folder / way / "bench.toml").write_text(before.toml)
    path = folder / "context" / "bench.toml"
    first = Bench.new(path)
    clumsily(path, before, robot, TRIALS, rng)
    shutil.copytree(folder / "context", folder / "carry on")
    first.context("new ground")
    found = [clumsily(path, after, robot, AFTER[-1], rng)]
    assert_same_as_quiet(path, folder / "quiet" / "bench.toml")
    for way in WAYS[1:]:
        found.append(
            run(Bench.new(folder / way / "bench.toml"), after, robot, AFTER[-1])
        )
    return np.minimum.accumulate(found, axis=1)[:, np.array(AFTER) - 1]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--seed", type=int, default=3301)
    parser.add_argument("--before", default="rough8-smooth")
    parser.add_argument("--after", default="risers")
    args = parser.parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    before, after = (Machine.of(name, args.seed) for name in (args.before, args.after))
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for robot in range(args.robots):
            found.append(rehearse(Path(folder, str(robot)), robot, before, after))
            print(robot, np.round(found[-1], 5).tolist(), flush=True)
    costs_of = np.array(found)  # [robots, ways, after]
    for way, name in enumerate(WAYS):
        print(
            f"{name:<9} median of the least cost:",
            *np.median(costs_of[:, way], axis=0).round(5),
        )
        for place, at in enumerate(AFTER) if way else ():
            ours, other = costs_of[:, 0, place], costs_of[:, way, place]
            won, lost = int((ours < other).sum()), int((ours > other).sum())
            print(
                f"  context, after {at}: won {won}, lost {lost}, p {wilcoxon(ours, other).p:.2g}"
            )


if __name__ == "__main__":
    main()
