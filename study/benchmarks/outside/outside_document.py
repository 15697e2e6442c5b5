"""The report on problems from outside as a Markdown document and a figure."""

from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.commit import commit_text, writable
from study.benchmarks.comparison_report import machine, versions
from study.benchmarks.outside.outside_arms import ARMS
from study.benchmarks.outside.outside_problem import OutsideProblem
from study.benchmarks.outside.outside_report import OURS, OutsideReport, Versus, worth
from study.palette import BLUE, BROWN, GREY, ORANGE, SKY_BLUE, VERMILION, VIOLET

Floats = NDArray[np.float64]

NAME = "sampler-outside"
PANELS_A_ROW = 3
LEGEND_IN = 2.9
# Okabe & Ito: ours in colour and unbroken, peers dashed, the ranking alone dotted.
LINES: dict[str, dict[str, Any]] = {
    "ours": {"color": BLUE, "linewidth": 1.8},
    "ours-prior": {"color": VERMILION, "linewidth": 1.8},
    "ranking": {"color": ORANGE, "linewidth": 1.5, "linestyle": ":"},
    "tpe-ranking": {"color": BROWN, "linewidth": 1.3, "linestyle": "--"},
    "tpe": {"color": VIOLET, "linewidth": 1.3, "linestyle": "--"},
    "gp": {"color": SKY_BLUE, "linewidth": 1.3, "linestyle": "--"},
    "cmaes": {"color": GREY, "linewidth": 1.3, "linestyle": "--"},
    "random": {"color": GREY, "linewidth": 1.3, "linestyle": (0, (1, 3))},
}


def write(folder: Path, report: OutsideReport, text: str) -> None:
    """Write `sampler-outside.md` and `.png` into a folder.

    Raises:
        InputError: the folder cannot be written.
    """
    path = folder / f"{NAME}.md"
    with writable(path):
        folder.mkdir(parents=True, exist_ok=True)
    _plot(folder / f"{NAME}.png", report)
    commit_text(path, text)


def markdown(report: OutsideReport, command: str) -> str:
    """The document; `command` made it."""
    lines = [
        "# Samplers on problems from outside",
        "",
        f"Written by `{command}` on {date.today()}: {machine()}; {versions()}.",
        "",
        "Nobody here invented these problems. Of each, the costly objective was computed once for"
        " every candidate of a pool (`study/benchmarks/outside/data`, one Parquet file each, with"
        f" the command that made it). {report.seeds} seeds an arm, all arms with their defaults."
        " A seed draws half of the pool, which is then the problem for every arm. Ours propose rows"
        " of it. Peers propose any point, and are told the cost of the nearest row: Euclidean in"
        " the unit cube, logarithmic parameters by their logarithm, a choice as one coordinate a"
        " choice, 0 or 1. CMA-ES draws choices at random, as it does everywhere in Optuna. The"
        " ranking is the mean rank of the features, each from its good end in the eyes of users;"
        f' "{ARMS["ours-prior"].label}" has it as one more feature and as `prior=`.',
        "",
        f"![Rank of the best row found against trials]({NAME}.png)",
        "",
        "The median over seeds of how many rows of the pool are as good as the best found.",
        "",
        "Tests are Wilcoxon's signed ranks, two-sided, seeds in pairs, not corrected for their"
        " number; bold: ours is behind (p < 0.05). Two halves"
        " of a pool share rows: the tests are of this pool, not of all that there might be.",
        *_bars(report),
    ]
    for problem in report.problems:
        lines += ["", *_problem(report, problem)]
    return "\n".join(lines) + "\n"


def _bars(report: OutsideReport) -> list[str]:
    """What must hold, and where it does not."""
    if not report.bars:
        return []
    head = "| what | holds | fails in (problem, against, trials, seeds won : lost) |"
    lines = ["", "## Bars", "", head, "|---|---|---|"]
    for bar in report.bars:
        lines.append(f"| {bar.what} | {_yes(bar.holds)} | {'; '.join(bar.fails)} |")
    return lines


def _problem(report: OutsideReport, problem: OutsideProblem) -> list[str]:
    """What the problem is, medians of its arms, and their tests."""
    name, at = problem.name, report.checkpoints
    share = np.quantile(problem.cost, [0.01, 0.5])
    lines = [
        f"## {name} ({problem.purpose})",
        "",
        f"{problem.field.capitalize()}: {problem.cost_meaning}. {len(problem):,} candidates of"
        f" {len(problem.space)} parameters ({', '.join(problem.space)}). Best possible"
        f" {problem.best:.4g}, best 1 % below {share[0]:.4g}, half below {share[1]:.4g}.",
        "",
        "| feature | good | what | Spearman with the cost, from the good end |",
        "|---|---|---|---|",
    ]
    worths = worth(problem)
    for feature, said in problem.feature_meanings.items():
        lines.append(f"| {feature} | {said.good} | {said.meaning} | {worths[feature]:.2f} |")
    lines.append(f"| ranking | low | mean rank of these | {worths['ranking']:.2f} |")
    head = " | ".join(f"after {trial}" for trial in at)
    lines += ["", f"| median of the best | told | different runs | {head} |",
              "|---|---|---|" + "---|" * len(at)]  # fmt: skip
    for arm in report.arms():
        cells = " | ".join(f"{report.median(name, arm, trial):.4g}" for trial in at)
        runs = report.different[name, arm]
        lines.append(f"| {ARMS[arm].label} | {ARMS[arm].sees} | {runs} | {cells} |")
    tests = [test for test in report.tests if test.problem == name]
    for ours in report.arms(*OURS):
        mine = [test for test in tests if test.ours == ours]
        lines += ["", f"| {ARMS[ours].label}, seeds won : lost, p | {head} |",
                  "|---|" + "---|" * len(at)]  # fmt: skip
        for other in dict.fromkeys(test.other for test in mine):
            cells = " | ".join(_cell(test) for test in mine if test.other == other)
            lines.append(f"| {ARMS[other].label} | {cells} |")
    return lines


def _cell(test: Versus) -> str:
    """Seeds won and lost, and how sure it is; bold where ours is behind."""
    text = f"{test.wins} : {test.losses}, {test.p:.2g}"
    return f"**{text}**" if test.is_behind else text


def _yes(holds: bool) -> str:
    return "yes" if holds else "**no**"


def _plot(path: Path, report: OutsideReport) -> None:
    """How many rows are as good as the best found against trials, a panel a problem."""
    from study.pictures import style

    problems = report.problems
    across = min(len(problems), PANELS_A_ROW)
    down = -(-len(problems) // PANELS_A_ROW)
    figure = style.new_figure(3.6 * across + LEGEND_IN, 3.0 * down)
    for place, problem in enumerate(problems):
        axes = figure.add_subplot(down, across, place + 1)
        style.tidy(axes)
        for arm in report.arms():
            median = np.median(_as_good(problem, report.best[problem.name, arm]), axis=0)
            axes.plot(np.arange(1, len(median) + 1), median, label=ARMS[arm].label, **LINES[arm])
        axes.set_yscale("log")
        axes.set_title(problem.name, fontsize=style.TITLE_PT, loc="left")
        axes.set_xlabel("trials", fontsize=style.TEXT_PT)
        axes.set_ylabel("rows as good as the best found", fontsize=style.TEXT_PT)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    right = 1.0 - LEGEND_IN / figure.get_figwidth()
    figure.legend(handles, labels, loc="center left", bbox_to_anchor=(right, 0.5),
                  fontsize=style.SMALL_PT, frameon=False)  # fmt: skip
    figure.tight_layout(rect=(0, 0, right, 1))
    style.save_png(figure, path)


def _as_good(problem: OutsideProblem, best: Floats) -> NDArray[np.int64]:
    """Rows of the pool that cost no more than the best found, [seeds, trials]; 1: the best row."""
    return np.searchsorted(np.sort(problem.cost), best, side="right")
