"""Compare our samplers with Optuna's on synthetic problems, and write a table and a plot.

    python tools/compare_peers.py                  # everything; a quarter of an hour or more
    python tools/compare_peers.py --seeds 3 --arms random,tpe,ours

Finished runs are kept in the cache's folder: the same command goes on where it was stopped, and a
run is repeated only where the code that made it has changed. GPSampler needs PyTorch, which this
project does not install: without it that arm is left out.
"""

import argparse
import json
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

    from study import palette
    from study.report.numbers import ENDS, Interval, resamples
    from tools.benchmarks import runs, synthetic
    from tools.benchmarks.runs import OURS, PEER, Bar, Costs, Floats, Run
    from tools.benchmarks.synthetic import ARMS

NAME = "sampler-comparison"
RESAMPLES = 4000
# Mean regret after 60 trials, 30 seeds, of the kernel that took turns with one of the parameters:
# docs/sampler-comparison.md of 0.1.0.
FORMER = {"misleading": 203.0, "useless": 205.0}
FORMER_TRIALS = 60

# Okabe & Ito: our arms in colour and unbroken, peers dashed, controls grey and dotted.
OUR_COLOURS = (palette.BLUE, palette.VERMILION, palette.GREEN, palette.PURPLE, palette.ORANGE,
               palette.BLACK)  # fmt: skip
PEER_COLOURS = (palette.GREY, palette.SKY_BLUE, palette.BROWN, palette.VIOLET)
LEGEND_IN = 2.0


def main() -> None:
    options = parse()
    arms = runs.runnable(options.arms)
    wanted = [
        Run("synthetic", problem, arm, seed, options.trials)
        for seed in range(options.seeds)
        for problem in options.problems
        for arm in arms
    ]
    report = Report.of(runs.execute(wanted, options.cache, options.processes))
    if options.json:
        print(json.dumps(report.as_dict()))
        return
    text = report.markdown()
    runs.write(options.out, NAME, text, report.plot)
    print(text)


def parse() -> argparse.Namespace:
    parser = runs.options(__file__, tuple(ARMS), trials=60, cache="peers")
    parser.add_argument("--problems", default=",".join(synthetic.PROBLEMS), help="%(default)s")
    options = runs.parsed(parser, tuple(ARMS))
    options.problems = runs.chosen("problems", options.problems, synthetic.PROBLEMS)
    return options


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
    def problems(self) -> list[str]:
        """The problems, in the order they were run."""
        return list(dict.fromkeys(problem for problem, _ in self.regret))

    def arms(self, problem: str) -> list[str]:
        """The arms run on a problem, in the order they were run."""
        return [arm for found, arm in self.regret if found == problem]

    def statistics(self, problem: str, arm: str, trial: int) -> tuple[Interval, Interval]:
        """Mean and median regret of an arm after so many trials."""
        regret = self.regret[problem, arm][:, trial - 1]
        return over_seeds(mean, regret), over_seeds(median, regret)

    def as_dict(self) -> dict[str, Any]:
        """Machine, versions, regret and bars as plain values."""
        cells = [
            (problem, arm, trial, *self.statistics(problem, arm, trial))
            for problem in self.problems
            for arm in self.arms(problem)
            for trial in self.checkpoints
        ]
        names = ("problem", "arm", "trial")
        return {
            "machine": runs.machine(),
            "versions": runs.versions(),
            "seeds": len(next(iter(self.regret.values()))),
            "regret": [
                dict(zip(names, cell[:3], strict=True))
                | {"mean": asdict(cell[3]), "median": asdict(cell[4])}
                for cell in cells
            ],
            "bars": [asdict(bar) for bar in self.bars],
        }

    def markdown(self) -> str:
        """The document: a table for each problem, then the bars."""
        seeds = len(next(iter(self.regret.values())))
        lines = [
            "# Samplers on synthetic problems in 16 dimensions",
            "",
            runs.made_by(),
            f"Simple regret, mean and median of {seeds} instances, with bootstrapped 95 %"
            " intervals. The problems are defined in `tools/benchmarks/synthetic.py`.",
            "",
            f"![Mean simple regret against trials]({NAME}.png)",
        ]
        for problem in self.problems:
            lines += ["", f"## {problem}", "", *self._table(problem)]
        return "\n".join([*lines, *Bar.table(self.bars, "measured")]) + "\n"

    def _table(self, problem: str) -> list[str]:
        """The lines of a problem's table, an arm each."""
        head = " | ".join(
            f"{what} after {trial}" for trial in self.checkpoints for what in ("mean", "median")
        )
        lines = [f"| sampler | chooses from | {head} |", "|---|---|---|---|---|---|"]
        for arm in self.arms(problem):
            found = [each for at in self.checkpoints for each in self.statistics(problem, arm, at)]
            cells = " | ".join(
                f"{each.value:.0f} ({each.low:.0f} to {each.high:.0f})" for each in found
            )
            lines.append(f"| {ARMS[arm].label} | {ARMS[arm].sees} | {cells} |")
        return lines

    def plot(self, path: Path) -> None:
        """Mean regret against trials, a panel a problem."""
        from study.pictures import style

        figure = style.new_figure(4.2 * len(self.problems) + LEGEND_IN, 3.8)
        for place, problem in enumerate(self.problems):
            axes = figure.add_subplot(1, len(self.problems), place + 1)
            style.tidy(axes)
            for arm in self.arms(problem):
                values = self.regret[problem, arm].mean(axis=0)
                axes.plot(np.arange(1, len(values) + 1), values, label=ARMS[arm].label, **line(arm))
            axes.set_title(problem, fontsize=style.TITLE_PT, loc="left")
            axes.set_xlabel("trials", fontsize=style.TEXT_PT)
            axes.set_ylabel("mean simple regret", fontsize=style.TEXT_PT)
        runs.save_panels(figure, path, LEGEND_IN)


def bars(regret: Costs, trials: int) -> list[Bar]:
    """The figures that have a bar, where their problems and arms were run."""
    half, found = trials // 2, []
    for (problem, arm), theirs in regret.items():
        if problem == "informative" and ARMS[arm].kind == PEER and (problem, "ours") in regret:
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


def line(arm: str) -> dict[str, Any]:
    """Colour, dashes and width of an arm's line."""
    kind = ARMS[arm].kind
    place = [name for name in ARMS if ARMS[name].kind == kind].index(arm)
    if kind == OURS:
        return {"color": OUR_COLOURS[place % len(OUR_COLOURS)], "linewidth": 1.8}
    if kind == PEER:
        return {"color": PEER_COLOURS[place], "linestyle": "--", "linewidth": 1.3}
    return {"color": palette.GREY, "linestyle": (0, (1, 1 + 2 * place)), "linewidth": 1.3}


if __name__ == "__main__":
    run_command(main)
