"""The report of a comparison on robots of any simulator: tables in Markdown, and a figure."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from study.experiment.robots import ARMS, RobotExperiment
from study.report.numbers import mcnemar, wilcoxon

Floats = NDArray[np.float64]

FIRST_TRIALS = (1, 3, 10)  # within which a walker is counted
CHECKPOINTS = (5, 10, 20, 30)  # trials after which costs are compared
OURS = ("worlds", "ranking")


@dataclass(frozen=True)
class RobotResults:
    """What the arms reached on the robots that all of them have tried."""

    experiment: RobotExperiment
    best: dict[str, Floats]  # least cost so far without noise, [robots, trials], by arm
    walked: dict[str, NDArray[np.bool_]]  # whether any trial so far lasted, [robots, trials]

    @classmethod
    def of(cls, experiment: RobotExperiment, trials: pa.Table) -> "RobotResults":
        """From all trials, as `compare_robots` gives them."""
        shape, count = (experiment.runs, experiment.trials), experiment.trials
        best, walked = {}, {}
        runs, numbers = trials["run"].to_numpy(), trials["trial"].to_numpy()
        arms = np.array(trials["arm"].to_pylist())
        for arm in experiment.arms:
            own = trials.filter((arms == arm) & (runs < shape[0]) & (numbers < count))
            cost, lasted = own["cost"].to_numpy(), own["survived"].to_numpy() >= 1.0
            best[arm] = np.minimum.accumulate(cost.reshape(shape), axis=1)
            walked[arm] = np.logical_or.accumulate(lasted.reshape(shape), axis=1)
        return cls(experiment, best, walked)

    def first_walker(self, arm: str) -> Floats:
        """Number of the first trial that lasted, from 1; infinite where none did, [robots]."""
        found = self.walked[arm]
        return np.where(found[:, -1], found.argmax(axis=1) + 1.0, np.inf)

    @property
    def checkpoints(self) -> tuple[int, ...]:
        """Trials after which costs are compared; the last is the end."""
        trials = self.experiment.trials
        return (*(at for at in CHECKPOINTS if at < trials), trials)

    def markdown(self) -> str:
        """The report."""
        known = self.experiment
        return "\n".join([
            f"# {known.name}",
            "",
            f"{known.runs} robots of {known.simulator.name}, {known.trials} trials of"
            f" {known.duration_s:g} s on each, seed {known.seed}. A robot's world is drawn from the"
            f" ranges of the configuration. A run that lasts costs its {known.cost}, at most"
            f" {known.fell_cost:g}; one that ends early costs more, up to {2 * known.fell_cost:g}."
            f" Samplers are told costs with {100 * known.noise:g} % noise; the tables are without.",
            "",
            *self._walkers(),
            "",
            *self._costs(),
            *self._tests(),
            "",
        ])  # fmt: skip

    def _walkers(self) -> Iterator[str]:
        within = [at for at in FIRST_TRIALS if at < self.experiment.trials]
        heads = ["first trial" if at == 1 else f"one of the first {at}" for at in within]
        yield f"| robots on which a trial lasted | knows of the store | {' | '.join(heads)} | any |"
        yield "|---|---|" + "---:|" * (len(within) + 1)
        for arm, walked in self.walked.items():
            counts = [str(int(walked[:, at - 1].sum())) for at in (*within, walked.shape[1])]
            yield f"| {ARMS[arm].label} | {ARMS[arm].sees} | {' | '.join(counts)} |"

    def _costs(self) -> Iterator[str]:
        at = self.checkpoints
        heads = " | ".join(f"after {trials}" for trials in at)
        yield f"| median of the least cost | first trial that lasts | {heads} |"
        yield "|---|---:|" + "---:|" * len(at)
        for arm, best in self.best.items():
            first = float(np.median(self.first_walker(arm)))
            cells = [f"{np.median(best[:, trials - 1]):.3g}" for trials in at]
            shown = f"{first:g}" if np.isfinite(first) else "none"
            yield f"| {ARMS[arm].label} | {shown} | {' | '.join(cells)} |"

    def _tests(self) -> Iterator[str]:
        """Wilcoxon's signed ranks of costs, McNemar's test of robots with a walker."""
        at = self.checkpoints
        for ours in OURS:
            others = [arm for arm in self.best if arm != ours]
            if ours not in self.best or not others:
                continue
            heads = " | ".join(f"after {trials}: won | lost | p" for trials in at)
            yield ""
            yield f"| {ARMS[ours].label} against | {heads} | walkers: p |"
            yield "|---|" + "---:|" * (3 * len(at) + 1)
            for other in others:
                cells = []
                for trials in at:
                    mine, theirs = (self.best[arm][:, trials - 1] for arm in (ours, other))
                    p = wilcoxon(mine, theirs).p
                    cells += [str((mine < theirs).sum()), str((mine > theirs).sum()), f"{p:.2g}"]
                p = mcnemar(self.walked[ours][:, -1], self.walked[other][:, -1]).p
                yield f"| {ARMS[other].label} | {' | '.join(cells)} | {p:.2g} |"

    def draw(self, path: Path) -> None:
        """Robots with a walker, and the median of the least cost, against trials."""
        from study.pictures import style  # Matplotlib: a second

        figure = style.new_figure(9.0, 3.6)
        trials = np.arange(1, self.experiment.trials + 1)
        left, right = (figure.add_subplot(1, 2, place) for place in (1, 2))
        colours = {arm: style.SERIES[place % len(style.SERIES)] for place, arm in enumerate(ARMS)}
        for arm, best in self.best.items():
            look: dict[str, Any] = {"color": colours[arm], "label": ARMS[arm].label,
                    "linewidth": 2.0 if arm in OURS else 1.2,
                    "linestyle": "-" if ARMS[arm].sees != "nothing" else "--"}  # fmt: skip
            left.step(trials, self.walked[arm].sum(axis=0), where="post", **look)
            right.plot(trials, np.median(best, axis=0), **look)
        left.set_ylabel("robots with a trial that lasted", fontsize=style.TEXT_PT)
        left.set_ylim(0, self.experiment.runs)
        right.set_ylabel("median of the least cost", fontsize=style.TEXT_PT)
        right.set_yscale("log")
        for axes in (left, right):
            style.tidy(axes)
            axes.set_xlabel("trials", fontsize=style.TEXT_PT)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="center left", bbox_to_anchor=(0.8, 0.5),
                      fontsize=style.SMALL_PT, frameon=False)  # fmt: skip
        figure.tight_layout(rect=(0, 0, 0.8, 1))
        style.save_png(figure, path)
