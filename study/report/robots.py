"""The report of a comparison on robots of any simulator: tables in Markdown."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from study.experiment.robots import ARMS, RobotExperiment
from study.report.markdown import WORDS, table
from study.report.numbers import mcnemar, wilcoxon
from study.report.runs import ArmRuns

FIRST_TRIALS = (1, 3, 10)  # within which a walker is counted
CHECKPOINTS = (5, 10, 20, 30)  # trials after which costs are compared
OURS = ("worlds", "ranking")


@dataclass(frozen=True)
class RobotResults:
    """What the arms reached on the robots that all of them have tried."""

    experiment: RobotExperiment
    arms: dict[str, ArmRuns]  # by name: a run is a robot, a walk lasted, costs are without noise

    @classmethod
    def of(cls, experiment: RobotExperiment, trials: pa.Table) -> "RobotResults":
        """From all trials, as `compare_robots` gives them."""
        shape = experiment.runs, experiment.trials
        runs, numbers = trials["run"].to_numpy(), trials["trial"].to_numpy()
        arms, found = np.array(trials["arm"].to_pylist()), {}
        for arm in experiment.arms:
            own = trials.filter((arms == arm) & (runs < shape[0]) & (numbers < shape[1]))
            cost, lasted = (own[name].to_numpy().reshape(shape) for name in ("cost", "survived"))
            best = np.minimum.accumulate(cost, axis=1)
            found[arm] = ArmRuns(arm, np.arange(shape[0]), best, lasted >= 1.0, len(own))
        return cls(experiment, found)

    @property
    def checkpoints(self) -> tuple[int, ...]:
        """Trials after which costs are compared; the last is the end."""
        trials = self.experiment.trials
        return (*(at for at in CHECKPOINTS if at < trials), trials)

    def markdown(self) -> str:
        """The report."""
        known, fell_cost = self.experiment, self.experiment.objective.fell_cost
        about = WORDS["robots"].format(
            name=known.name, runs=known.runs, simulator=known.simulator.name, trials=known.trials,
            seconds=known.duration_s, seed=known.seed, cost=known.objective.cost, most=fell_cost,
            twice=2 * fell_cost, noise=100 * known.noise,
        )  # fmt: skip
        return "\n\n".join([about, self._walkers(), self._costs(), *self._tests()]) + "\n"

    def _walkers(self) -> str:
        within = [at for at in FIRST_TRIALS if at < self.experiment.trials]
        heads = ["first trial" if at == 1 else f"one of the first {at}" for at in within]
        rows = []
        for arm, own in self.arms.items():
            counts = [str(own.has_walker[:, at - 1].sum()) for at in (*within, own.trials)]
            rows.append([ARMS[arm].label, ARMS[arm].sees, *counts])
        first = "robots on which a trial lasted", "knows of the store"
        return table([*first, *heads, "any"], rows)

    def _costs(self) -> str:
        rows = []
        for arm, own in self.arms.items():
            first = float(np.median(own.first_walker))
            cells = [f"{np.median(own.best[:, trials - 1]):.3g}" for trials in self.checkpoints]
            rows.append([ARMS[arm].label, f"{first:g}" if np.isfinite(first) else "none", *cells])
        heads = [f"after {trials}" for trials in self.checkpoints]
        return table(["median of the least cost", "first trial that lasts", *heads], rows)

    def _tests(self) -> Iterator[str]:
        """Wilcoxon's signed ranks of costs, McNemar's test of robots with a walker."""
        for ours in OURS:
            others = [arm for arm in self.arms if arm != ours]
            if ours not in self.arms or not others:
                continue
            rows = []
            for other in others:
                cells = []
                for trials in self.checkpoints:
                    mine, theirs = (self.arms[arm].best[:, trials - 1] for arm in (ours, other))
                    p = wilcoxon(mine, theirs).p
                    cells += [str((mine < theirs).sum()), str((mine > theirs).sum()), f"{p:.2g}"]
                p = mcnemar(*(self.arms[arm].has_walker[:, -1] for arm in (ours, other))).p
                rows.append([ARMS[other].label, *cells, f"{p:.2g}"])
            heads = [h for at in self.checkpoints for h in (f"after {at}: won", "lost", "p")]
            yield table([f"{ARMS[ours].label} against", *heads, "walkers: p"], rows)
