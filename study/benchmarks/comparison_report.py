"""The comparison of samplers as a Markdown table, a plot and plain values, with its bars."""

import os
import platform
from dataclasses import asdict, dataclass
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.commit import commit_text, writable
from study.benchmarks.peers import PEERS
from study.benchmarks.regret import Summary, mean_of, median_of, ratio_of_means, simple_regret
from study.palette import (
    BLACK,
    BLUE,
    BROWN,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    VIOLET,
)  # fmt: skip

Floats = NDArray[np.float64]
Costs = dict[tuple[str, str], Floats]

OURS = "ours"  # the arm with our defaults
PACKAGES = ("numpy", "scipy", "scikit-learn", "optuna", "cmaes", "torch", "greenlet")
# Mean regret after 60 trials, 30 seeds, of the kernel that took turns with one of the parameters:
# docs/sampler-comparison.md of 0.1.0.
FORMER = {"misleading": 203.0, "useless": 205.0}
FORMER_TRIALS = 60

# Okabe & Ito: our arms in colour and unbroken, peers dashed, controls grey and dotted.
OUR_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, BLACK)
PEER_COLOURS = (GREY, SKY_BLUE, BROWN, VIOLET)


@dataclass(frozen=True)
class Bar:
    """A figure beside what it must be."""

    what: str
    measured: Summary
    at_most: float

    @property
    def holds(self) -> bool:
        """Whether the figure itself (not the end of its interval) is low enough."""
        return self.measured.value <= self.at_most


@dataclass(frozen=True, eq=False)
class Report:
    """Everything that the runs say.

    Attributes:
        regret: of each problem and arm, [seeds, trials].
        checkpoints: half of the trials, and all of them.
        bars: that the problems and arms at hand allow to check.
    """

    regret: Costs
    checkpoints: tuple[int, int]
    bars: tuple[Bar, ...]

    @classmethod
    def of(cls, costs: Costs) -> "Report":
        """The report of costs, [seeds, trials] for each (problem, arm)."""
        regret = {key: simple_regret(values) for key, values in costs.items()}
        trials = next(iter(costs.values())).shape[1]
        checkpoints = (trials // 2, trials)
        return cls(regret, checkpoints, tuple(_bars(regret, checkpoints)))

    @property
    def problems(self) -> list[str]:
        """The problems, in the order they were run."""
        return list(dict.fromkeys(problem for problem, _ in self.regret))

    def arms(self, problem: str) -> list[str]:
        """The arms run on a problem, in the order they were run."""
        return [arm for found, arm in self.regret if found == problem]

    def at(self, problem: str, arm: str, trial: int) -> Floats:
        """Regret of each seed after so many trials, [seeds]."""
        return np.asarray(self.regret[problem, arm][:, trial - 1])

    def as_dict(self) -> dict[str, Any]:
        """Machine, versions, regret and bars as plain values."""
        return {
            "machine": machine(),
            "versions": versions(),
            "seeds": len(next(iter(self.regret.values()))),
            "regret": [
                {"problem": problem, "arm": arm, "trial": trial, "mean": asdict(mean),
                 "median": asdict(median)}
                for problem in self.problems
                for arm in self.arms(problem)
                for trial in self.checkpoints
                for mean, median in [self._statistics(problem, arm, trial)]
            ],
            "bars": [{**asdict(bar), "holds": bar.holds} for bar in self.bars],
        }  # fmt: skip

    def markdown(self, command: str) -> str:
        """The document: a table for each problem, then the bars; `command` made it."""
        seeds = len(next(iter(self.regret.values())))
        lines = [
            "# Samplers on synthetic problems in 16 dimensions",
            "",
            f"Written by `{command}` on {date.today()}: {machine()}; {versions()}.",
            f"Simple regret, mean and median of {seeds} instances, with bootstrapped 95 %"
            " intervals. The problems are defined in `study/benchmarks/synthetic.py`.",
            "",
            "![Mean simple regret against trials](sampler-comparison.png)",
        ]
        for problem in self.problems:
            lines += ["", f"## {problem}", "", *self._table(problem)]
        if self.bars:
            lines += [
                "",
                "## Bars",
                "",
                "| what | measured | at most | holds |",
                "|---|---|---|---|",
            ]
            lines += [_bar_row(bar) for bar in self.bars]
        return "\n".join(lines) + "\n"

    def _statistics(self, problem: str, arm: str, trial: int) -> tuple[Summary, Summary]:
        """Mean and median regret of an arm after so many trials."""
        regret = self.at(problem, arm, trial)
        return mean_of(regret), median_of(regret)

    def _table(self, problem: str) -> list[str]:
        """The lines of a problem's table, an arm each."""
        half, full = self.checkpoints
        head = " | ".join(f"{what} after {n}" for n in (half, full) for what in ("mean", "median"))
        lines = [f"| sampler | chooses from | {head} |", "|---|---|---|---|---|---|"]
        for arm in self.arms(problem):
            cells = [
                _cell(summary)
                for trial in self.checkpoints
                for summary in self._statistics(problem, arm, trial)
            ]
            lines.append(f"| {PEERS[arm].label} | {PEERS[arm].sees} | {' | '.join(cells)} |")
        return lines


def write(folder: Path, report: Report, text: str) -> None:
    """Write `sampler-comparison.md` and `.png` into a folder."""
    path = folder / "sampler-comparison.md"
    with writable(path):
        folder.mkdir(parents=True, exist_ok=True)
    _plot(folder / "sampler-comparison.png", report)
    commit_text(path, text)


def machine() -> str:
    """What the runs were made on, in words."""
    return f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def versions() -> str:
    """Python and the packages that decide the figures."""
    found = [f"Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"no {package}")
    return ", ".join(found)


def _bars(regret: Costs, checkpoints: tuple[int, int]) -> list[Bar]:
    """The figures that have a bar, where their problems and arms were run."""
    half, full = (trial - 1 for trial in checkpoints)
    bars = []
    for (problem, arm), theirs in regret.items():
        if problem == "informative" and PEERS[arm].kind == "peer" and (problem, OURS) in regret:
            ratio = ratio_of_means(regret[problem, OURS][:, half], theirs[:, full])
            what = f"{problem}: ours after {half + 1} / {PEERS[arm].label} after {full + 1}"
            bars.append(Bar(what, ratio, 1.0))
        if problem in FORMER and arm == OURS and full + 1 == FORMER_TRIALS:
            what = f"{problem}: mean regret of ours after {full + 1}"
            bars.append(Bar(what, mean_of(theirs[:, full]), FORMER[problem]))
    return bars


def _cell(summary: Summary) -> str:
    """A statistic and its interval, as a cell of a table."""
    return f"{summary.value:.0f} ({summary.low:.0f} to {summary.high:.0f})"


def _bar_row(bar: Bar) -> str:
    """A bar as a row of a table."""
    measured = f"{bar.measured.value:.2f} ({bar.measured.low:.2f} to {bar.measured.high:.2f})"
    return f"| {bar.what} | {measured} | {bar.at_most:g} | {'yes' if bar.holds else '**no**'} |"


def _plot(path: Path, report: Report) -> None:
    """Mean regret against trials, a panel a problem."""
    from study.pictures import style

    problems = report.problems
    figure = style.new_figure(4.2 * len(problems) + 2.2, 3.8)
    for place, problem in enumerate(problems):
        axes = figure.add_subplot(1, len(problems), place + 1)
        style.tidy(axes)
        for arm in report.arms(problem):
            mean = report.regret[problem, arm].mean(axis=0)
            axes.plot(np.arange(1, len(mean) + 1), mean, label=PEERS[arm].label, **_line(arm))
        axes.set_title(problem, fontsize=style.TITLE_PT, loc="left")
        axes.set_xlabel("trials", fontsize=style.TEXT_PT)
        axes.set_ylabel("mean simple regret", fontsize=style.TEXT_PT)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    right = 1.0 - 2.0 / figure.get_figwidth()
    figure.legend(handles, labels, loc="center left", bbox_to_anchor=(right, 0.5),
                  fontsize=style.SMALL_PT, frameon=False)  # fmt: skip
    figure.tight_layout(rect=(0, 0, right, 1))
    style.save_png(figure, path)


def _line(arm: str) -> dict[str, Any]:
    """Colour, dashes and width of an arm's line."""
    kind = PEERS[arm].kind
    alike = [name for name in PEERS if PEERS[name].kind == kind]
    place = alike.index(arm)
    if kind == "ours":
        return {"color": OUR_COLOURS[place % len(OUR_COLOURS)], "linewidth": 1.8}
    if kind == "peer":
        return {"color": PEER_COLOURS[place], "linestyle": "--", "linewidth": 1.3}
    return {"color": GREY, "linestyle": (0, (1, 1 + 2 * place)), "linewidth": 1.3}
