"""Compare our samplers with Optuna's on synthetic problems, and write a table and a plot.

    python tools/compare_peers.py                  # everything; a quarter of an hour or more
    python tools/compare_peers.py --seeds 3 --arms random,tpe,ours

The cache keeps finished runs: the same command resumes, and a run is repeated only where the code
that made it has changed. GPSampler needs PyTorch, which this project does not install: without it
that arm is left out.
"""

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    import numpy as np

    from study.report.numbers import ENDS, Interval, resamples
    from tools.benchmarks import runs, synthetic
    from tools.benchmarks.arms import Floats
    from tools.benchmarks.documents import (
        Bar,
        draw_panels,
        machine,
        made_by,
        publish,
        versions,
    )
    from tools.benchmarks.runs import Costs
    from tools.benchmarks.synthetic import ARMS

NAME = "sampler-comparison"
RESAMPLES = 4000
# Mean regret after 60 trials, 30 seeds, of the kernel that took turns with one of the parameters:
# docs/sampler-comparison.md of 0.1.0.
FORMER = {"misleading": 203.0, "useless": 205.0}
FORMER_TRIALS = 60


def main() -> None:
    groups = {"all": synthetic.PROBLEMS}
    options = runs.parse(__file__, "synthetic", trials=60, cache="peers", groups=groups)
    publish(options, NAME, Report.of(runs.compared("synthetic", options)))


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

    The least possible cost of every problem is 0: the regret is the least cost so far.

    Attributes:
        regret: of each problem and arm, [seeds, trials].
        checkpoints: half of the trials, and all of them.
        bars: as far as they can be checked.
    """

    regret: Costs
    checkpoints: tuple[int, int]
    bars: tuple[Bar, ...]

    @classmethod
    def of(cls, costs: Costs) -> "Report":
        """The report of costs, [seeds, trials] for each (problem, arm)."""
        regret = {key: np.minimum.accumulate(values, axis=-1) for key, values in costs.items()}
        trials = next(iter(costs.values())).shape[1]
        return cls(regret, (trials // 2, trials), tuple(bars(regret, trials)))

    @property
    def seeds(self) -> int:
        """Number of seeds of each arm."""
        return len(next(iter(self.regret.values())))

    def statistics(self, problem: str, arm: str, trial: int) -> tuple[Interval, Interval]:
        """Mean and median regret of an arm after so many trials."""
        regret = self.regret[problem, arm][:, trial - 1]
        return over_seeds(mean, regret), over_seeds(median, regret)

    def as_dict(self) -> dict[str, Any]:
        """Machine, versions, regret and bars as plain values."""
        regret = []
        for problem, arm in self.regret:
            for trial in self.checkpoints:
                mean, median = self.statistics(problem, arm, trial)
                regret.append({"problem": problem, "arm": arm, "trial": trial,
                               "mean": asdict(mean), "median": asdict(median)})  # fmt: skip
        return {
            "machine": machine(),
            "versions": versions(),
            "seeds": self.seeds,
            "regret": regret,
            "bars": [asdict(bar) for bar in self.bars],
        }

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
            " intervals. The problems are defined in `tools/benchmarks/synthetic.py`.",
            "",
            f"![Mean simple regret against trials]({NAME}.png)",
        ]
        above = ""
        for problem, arm in self.regret:
            if problem != above:
                lines += ["", f"## {problem}", "", f"| sampler | chooses from | {head} |",
                          "|---|---|---|---|---|---|"]  # fmt: skip
            above = problem
            found = [each for at in self.checkpoints for each in self.statistics(problem, arm, at)]
            cells = " | ".join(f"{i.value:.0f} ({i.low:.0f} to {i.high:.0f})" for i in found)
            lines.append(f"| {ARMS[arm].label} | {ARMS[arm].sees} | {cells} |")
        return "\n".join([*lines, *Bar.table(self.bars, "measured")]) + "\n"

    def plot(self, path: Path) -> None:
        """Mean regret against trials, a panel a problem."""

        def curve(problem: str, arm: str) -> Floats | None:
            regret = self.regret.get((problem, arm))
            return None if regret is None else regret.mean(axis=0)

        problems = list(dict.fromkeys(problem for problem, _ in self.regret))
        label = "mean simple regret"
        draw_panels(path, ARMS, problems, curve, label, len(problems), (4.2, 3.8), legend_in=2.0)


def bars(regret: Costs, trials: int) -> list[Bar]:
    """The figures that have a bar, where their problems and arms were run."""
    half, found = trials // 2, []
    for (problem, arm), theirs in regret.items():
        if problem == "informative" and ARMS[arm].kind == "peer" and (problem, "ours") in regret:
            compared = over_seeds(ratio, regret[problem, "ours"][:, half - 1], theirs[:, -1])
            what = f"{problem}: ours after {half} / {ARMS[arm].label} after {trials}"
            found.append(at_most(what, compared, 1.0))
        if problem in FORMER and arm == "ours" and trials == FORMER_TRIALS:
            what = f"{problem}: mean regret of ours after {trials}"
            found.append(at_most(what, over_seeds(mean, theirs[:, -1]), FORMER[problem]))
    return found


def at_most(what: str, measured: Interval, bar: float) -> Bar:
    """A bar for the figure itself, not for the end of its interval."""
    text = f"{measured.value:.2f} ({measured.low:.2f} to {measured.high:.2f}), at most {bar:g}"
    return Bar(what, text, measured.value <= bar)


if __name__ == "__main__":
    run_command(main)
