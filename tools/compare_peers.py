"""Compare our samplers with Optuna's on synthetic problems, and write a table and a plot.

    python tools/compare_peers.py                  # everything; a quarter of an hour or more
    python tools/compare_peers.py --seeds 3 --arms random,tpe,ours

The cache keeps finished runs: the same command resumes, and a run is repeated only where the code
that made it has changed. GPSampler needs PyTorch, which this project does not install: without it
that arm is left out.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np

    from study.report.numbers import ENDS, Interval, resamples
    from tools import benchmark, synthetic
    from tools.benchmark import Bar, Costs, Floats, draw_panels, made_by
    from tools.synthetic import ARMS

NAME = "sampler-comparison"
RESAMPLES = 4000
# Mean regret after 60 trials, 30 seeds, of the kernel that took turns with one of the parameters:
# docs/sampler-comparison.md of 0.1.0.
FORMER = {"misleading": 203.0, "useless": 205.0}
FORMER_TRIALS = 60


def main() -> None:
    options = benchmark.parse(__file__, "synthetic", trials=60, cache="peers")
    benchmark.publish(options, NAME, Report.of(benchmark.compared("synthetic", options)))


def over_seeds(statistic: Callable[..., Floats], *values: Floats) -> Interval:
    """A statistic of values [seeds], with its 95 % interval; the seeds are resampled together."""
    drawn = resamples(len(values[0]), RESAMPLES)
    low, high = np.quantile(statistic(*(value[drawn] for value in values)), ENDS)
    return Interval(float(statistic(*values)), float(low), float(high))


def mean(values: Floats) -> Floats:
    return np.asarray(values.mean(axis=-1))


def median(values: Floats) -> Floats:
    return np.asarray(np.median(values, axis=-1))


def ratio(ours: Floats, theirs: Floats) -> Floats:
    return mean(ours) / mean(theirs)


@dataclass(frozen=True, eq=False)
class Report:
    """Simple regret of the runs, and the bars that the problems and arms at hand allow to check.

    Regret is the least cost so far, since the least possible cost of every problem is 0.
    """

    best: Costs  # of each problem and arm, [seeds, trials]

    @classmethod
    def of(cls, costs: Costs) -> "Report":
        """The report of costs, [seeds, trials] for each (problem, arm)."""
        return cls({key: np.minimum.accumulate(found, axis=1) for key, found in costs.items()})

    @property
    def seeds(self) -> int:
        """Number of seeds of each arm."""
        return len(next(iter(self.best.values())))

    @property
    def checkpoints(self) -> tuple[int, int]:
        """Half of the trials, and all of them."""
        trials = next(iter(self.best.values())).shape[1]
        return trials // 2, trials

    @property
    def bars(self) -> list[Bar]:
        """The figures that have a bar, where their problems and arms were run."""
        (half, trials), found = self.checkpoints, []
        for (problem, arm), theirs in self.best.items():
            ours = self.best.get((problem, "ours"))
            if problem == "informative" and ARMS[arm].kind == "peer" and ours is not None:
                compared = over_seeds(ratio, ours[:, half - 1], theirs[:, -1])
                what = f"{problem}: ours after {half} / {ARMS[arm].label} after {trials}"
                found.append(at_most(what, compared, 1.0))
            if problem in FORMER and arm == "ours" and trials == FORMER_TRIALS:
                what = f"{problem}: mean regret of ours after {trials}"
                found.append(at_most(what, over_seeds(mean, theirs[:, -1]), FORMER[problem]))
        return found

    def statistics(self, problem: str, arm: str, trial: int) -> dict[str, Interval]:
        """Mean and median regret of an arm after so many trials."""
        regret = self.best[problem, arm][:, trial - 1]
        return {"mean": over_seeds(mean, regret), "median": over_seeds(median, regret)}

    def as_dict(self) -> dict[str, Any]:
        """Seeds and regret as plain values."""
        regret = [
            {"problem": problem, "arm": arm, "trial": trial}
            | {name: asdict(found) for name, found in self.statistics(problem, arm, trial).items()}
            for problem, arm in self.best for trial in self.checkpoints
        ]  # fmt: skip
        return {"seeds": self.seeds, "regret": regret}

    def markdown(self) -> str:
        """The document: a table for each problem, then the bars."""
        head = " | ".join(
            f"{what} after {trial}" for trial in self.checkpoints for what in ("mean", "median")
        )
        lines = [
            "# Samplers on synthetic problems in 16 dimensions",
            "",
            made_by(),
            f"Simple regret, mean and median of {self.seeds} instances, with bootstrapped 95 %"
            " intervals. The problems are defined in `tools/synthetic.py`.",
            "",
            f"![Mean simple regret against trials]({NAME}.png)",
        ]
        above = ""
        for problem, arm in self.best:
            if problem != above:
                lines += ["", f"## {problem}", "", f"| sampler | chooses from | {head} |",
                          "|---|---|---|---|---|---|"]  # fmt: skip
            above = problem
            found = [self.statistics(problem, arm, at).values() for at in self.checkpoints]
            cells = " | ".join(
                f"{i.value:.0f} ({i.low:.0f} to {i.high:.0f})" for pair in found for i in pair
            )
            lines.append(f"| {ARMS[arm].label} | {ARMS[arm].sees} | {cells} |")
        return "\n".join([*lines, *Bar.table(self.bars, "measured")]) + "\n"

    def plot(self, path: Path) -> None:
        """Mean regret against trials, a panel a problem."""
        curves = {key: regret.mean(axis=0) for key, regret in self.best.items()}
        label, across = "mean simple regret", len(synthetic.PROBLEMS)
        draw_panels(path, ARMS, curves, label, across, (4.2, 3.8), legend_in=2.0)


def at_most(what: str, measured: Interval, bar: float) -> Bar:
    """A bar for the figure itself, not for the end of its interval."""
    text = f"{measured.value:.2f} ({measured.low:.2f} to {measured.high:.2f}), at most {bar:g}"
    return Bar(what, text, measured.value <= bar)


if __name__ == "__main__":
    run_command(main)
