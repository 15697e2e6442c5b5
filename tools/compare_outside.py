"""Compare our samplers with Optuna's on tuning problems from outside, and write a table and a plot.

    python tools/compare_outside.py                    # the problems for tuning
    python tools/compare_outside.py --problems all     # those that are only reported as well
    python tools/compare_outside.py --seeds 3 --arms ours,tpe --problems transport-solver

Finished runs are kept in the cache's folder: the same command goes on where it was stopped, and a
run is repeated only where the code or the numbers that made it have changed. GPSampler needs
PyTorch, which this project does not install: without it that arm is left out.
"""

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    from numpy.typing import NDArray
    from scipy.stats import rankdata, spearmanr

    from study import palette
    from study.report.numbers import wilcoxon
    from tools.benchmarks import outside, runs
    from tools.benchmarks.outside import ARMS, OutsideProblem, outside_problem
    from tools.benchmarks.runs import OURS, PEER, Bar, Costs, Floats, Run

NAME = "sampler-outside"
GROUPS = {"tuning": outside.TUNING, "reported": outside.REPORTED, "all": outside.PROBLEMS}
CHECKPOINTS = (5, 10, 20, 40)  # trials
OUR_ARMS = tuple(name for name, arm in ARMS.items() if arm.kind == OURS)
WITHOUT_HINT = tuple(name for name, arm in ARMS.items() if arm.kind == PEER and not arm.enqueued)
BEHIND_P, AHEAD_P = 0.05, 0.01
PANELS_A_ROW = 3
LEGEND_IN = 2.9
# Okabe & Ito: ours in colour and unbroken, peers dashed, the ranking alone dotted.
LINES: dict[str, dict[str, Any]] = {
    "ours": {"color": palette.BLUE, "linewidth": 1.8},
    "ours-prior": {"color": palette.VERMILION, "linewidth": 1.8},
    "ranking": {"color": palette.ORANGE, "linewidth": 1.5, "linestyle": ":"},
    "tpe-ranking": {"color": palette.BROWN, "linewidth": 1.3, "linestyle": "--"},
    "tpe": {"color": palette.VIOLET, "linewidth": 1.3, "linestyle": "--"},
    "gp": {"color": palette.SKY_BLUE, "linewidth": 1.3, "linestyle": "--"},
    "cmaes": {"color": palette.GREY, "linewidth": 1.3, "linestyle": "--"},
    "random": {"color": palette.GREY, "linewidth": 1.3, "linestyle": (0, (1, 3))},
}


def main() -> None:
    options = parse()
    arms = runs.runnable(options.arms)
    wanted = [
        Run("outside", problem, arm, seed, options.trials)
        for problem in options.problems
        for arm in arms
        for seed in range(options.seeds)
    ]
    report = OutsideReport.of(runs.execute(wanted, options.cache, options.processes))
    if options.json:
        print(json.dumps(report.as_dict()))
        return
    text = markdown(report)
    runs.write(options.out, NAME, text, lambda path: plot(path, report))
    print(text)


def parse() -> argparse.Namespace:
    parser = runs.options(__file__, tuple(ARMS), trials=40, cache="outside")
    names = ",".join(outside.PROBLEMS)
    parser.add_argument(
        "--problems", default="tuning", help=f"{', '.join(GROUPS)}, or some of {names}; %(default)s"
    )
    options = runs.parsed(parser, tuple(ARMS))
    group = GROUPS.get(options.problems)
    options.problems = group or runs.chosen("problems", options.problems, outside.PROBLEMS)
    return options


@dataclass(frozen=True)
class Versus:
    """One of our arms against another, seeds in pairs, after so many trials.

    Attributes:
        problem: by name.
        ours: arm.
        other: arm.
        trial: of both; the other's may be less (`other_trial`).
        other_trial: at which the other is looked at.
        wins: seeds on which ours had found a lower cost.
        losses: seeds on which the other had.
        p: Wilcoxon's signed-rank test, two-sided, not corrected for how many tests there are.
        ahead: whether ours leads, by the test's sum of signed ranks (or nobody does).
    """

    problem: str
    ours: str
    other: str
    trial: int
    other_trial: int
    wins: int
    losses: int
    p: float
    ahead: bool

    @property
    def is_behind(self) -> bool:
        """Whether the other leads, beyond chance."""
        return not self.ahead and self.p < BEHIND_P

    @property
    def is_ahead(self) -> bool:
        """Whether ours leads, well beyond chance."""
        return self.ahead and self.p < AHEAD_P


@dataclass(frozen=True, eq=False)
class OutsideReport:
    """Everything that the runs say.

    Attributes:
        best: least cost so far, [seeds, trials] for each (problem, arm).
        checkpoints: trials at which arms are compared.
        different: how many of the seeds' runs differ at all, for each (problem, arm); a sampler
            that draws nothing repeats one run, and its seeds are then no sample.
    """

    best: Costs
    checkpoints: tuple[int, ...]
    different: dict[tuple[str, str], int]

    @classmethod
    def of(cls, costs: Costs) -> "OutsideReport":
        """The report of costs, [seeds, trials] for each (problem, arm)."""
        trials = next(iter(costs.values())).shape[1]
        best = {key: np.minimum.accumulate(values, axis=1) for key, values in costs.items()}
        checkpoints = (*(at for at in CHECKPOINTS if at < trials), trials)
        return cls(best, checkpoints, {k: len(np.unique(v, axis=0)) for k, v in costs.items()})

    @property
    def seeds(self) -> int:
        """Of each arm."""
        return len(next(iter(self.best.values())))

    @property
    def problems(self) -> list[OutsideProblem]:
        """In the order they were run."""
        return [outside_problem(name) for name in dict.fromkeys(name for name, _ in self.best)]

    def arms(self, *among: str) -> list[str]:
        """The arms that were run, in their order; of those named, if any are."""
        run = dict.fromkeys(arm for _, arm in self.best)
        return [arm for arm in ARMS if arm in run and (not among or arm in among)]

    def median(self, problem: str, arm: str, trial: int) -> float:
        """Median over seeds of the least cost after so many trials."""
        return float(np.median(self.best[problem, arm][:, trial - 1]))

    def versus(
        self, problem: str, ours: str, other: str, trial: int, other_trial: int | None = None
    ) -> Versus:
        """One of our arms against another; both after `trial`, unless the other has a number."""
        at = other_trial or trial
        mine, theirs = self.best[problem, ours][:, trial - 1], self.best[problem, other][:, at - 1]
        wins, losses = int((mine < theirs).sum()), int((mine > theirs).sum())
        more = (mine - theirs)[mine != theirs]
        ahead = bool((rankdata(np.abs(more)) * np.sign(more)).sum() <= 0)
        p = wilcoxon(mine, theirs).p
        return Versus(problem, ours, other, trial, at, wins, losses, p, ahead)

    @cached_property
    def tests(self) -> list[Versus]:
        """Each of our arms against every arm that is not ours, at every checkpoint."""
        others = [arm for arm in self.arms() if ARMS[arm].kind != OURS]
        return [
            self.versus(problem.name, ours, other, trial)
            for problem in self.problems
            for ours in self.arms(*OUR_ARMS)
            for other in others
            for trial in self.checkpoints
        ]

    @cached_property
    def bars(self) -> list[Bar]:
        """The bars of our arms, as far as the runs allow to check them."""
        found = []
        for ours in self.arms(*OUR_ARMS):
            label = ARMS[ours].label
            others = self.arms(*WITHOUT_HINT)
            rounds = [
                self.versus(problem.name, ours, other, at)
                for problem in self.problems
                for other in others
                for at in self.checkpoints
            ]
            what = f"{label}: never behind a sampler without features (p < {BEHIND_P:g})"
            found.append(never(what, [each for each in rounds if each.is_behind]))
            for at in (10, self.checkpoints[-1]):
                if "tpe" in others and at in self.checkpoints:
                    what = f"{label}: ahead of TPESampler after {at} (p < {AHEAD_P:g})"
                    of_tpe = [each for each in rounds if (each.other, each.trial) == ("tpe", at)]
                    found.append(never(what, [each for each in of_tpe if not each.is_ahead]))
        if "ranking" in self.arms():
            found += self._bars_of_ranking()
        return found

    def _bars_of_ranking(self) -> list[Bar]:
        """With the ranking as prior no worse than it; without a hint, after 10, as it after 5."""
        found = []
        if "ours-prior" in self.arms():
            rounds = [self.versus(problem.name, "ours-prior", "ranking", at)
                      for problem in self.problems for at in self.checkpoints]  # fmt: skip
            what = f"{ARMS['ours-prior'].label}: never behind the ranking alone (p < {BEHIND_P:g})"
            found.append(never(what, [each for each in rounds if each.is_behind]))
        if "ours" in self.arms() and {5, 10} <= set(self.checkpoints):
            rounds = [
                self.versus(problem.name, "ours", "ranking", 10, 5) for problem in self.problems
            ]
            what = (
                f"{ARMS['ours'].label}: after 10 not behind the ranking after 5 (p < {BEHIND_P:g})"
            )
            found.append(never(what, [each for each in rounds if each.is_behind]))
        return found

    def as_dict(self) -> dict[str, Any]:
        """Medians, tests and bars as plain values."""
        return {
            "seeds": self.seeds,
            "problems": [
                {"name": problem.name, "purpose": problem.purpose, "best": problem.best,
                 "spearman": worth(problem)}
                for problem in self.problems
            ],
            "medians": [
                {"problem": problem.name, "arm": arm, "trial": trial,
                 "median": self.median(problem.name, arm, trial)}
                for problem in self.problems for arm in self.arms() for trial in self.checkpoints
            ],
            "different_runs": [
                {"problem": problem, "arm": arm, "runs": count}
                for (problem, arm), count in self.different.items()
            ],
            "tests": [asdict(test) for test in self.tests],
            "bars": [asdict(bar) for bar in self.bars],
        }  # fmt: skip


def worth(problem: OutsideProblem) -> dict[str, float]:
    """Rank correlation with the cost of each feature from its good end, and of the ranking.

    Where the feature failed, it ranks last.
    """
    columns = dict(zip(problem.feature_names, problem.ranks.T, strict=True))
    columns["ranking"] = problem.ranking
    return {name: float(spearmanr(c, problem.cost).statistic) for name, c in columns.items()}


def never(what: str, rounds: list[Versus]) -> Bar:
    """A bar that must fail nowhere: it fails in these problems, against these arms."""
    fails = [
        f"{each.problem}, {ARMS[each.other].label}, {each.trial} ({each.wins} : {each.losses})"
        for each in rounds
    ]
    return Bar(what, "; ".join(fails), not fails)


def markdown(report: OutsideReport) -> str:
    """The document."""
    lines = [
        "# Samplers on problems from outside",
        "",
        runs.made_by(),
        "",
        "These problems were not invented here. The costly objective of each was computed once for"
        " every candidate of a pool (`tools/benchmarks/data`, one Parquet file each). Every arm has"
        f" {report.seeds} seeds and its default options. A seed draws half of the pool, which is"
        " then the problem of every arm.",
        "",
        "- *Ours* proposes rows of the pool. Its peers propose any point and get the cost of the"
        " nearest row: Euclidean distance in the unit cube, logarithmic parameters by their"
        " logarithm, a choice as one coordinate an option, 0 or 1.",
        "- `CmaEsSampler` draws choices at random, as everywhere in Optuna.",
        "- The *ranking* is the mean rank of the features, each counted from the end that users"
        f' consider good. "{ARMS["ours-prior"].label}" has the ranking as one more feature and as'
        " `prior=`.",
        "",
        f"![Rank of the best row found against trials]({NAME}.png)",
        "",
        "The figure shows the median over seeds of the number of rows that are as good as the best"
        " row found.",
        "",
        "Tests are Wilcoxon's signed ranks, two-sided, paired by seed, not corrected for their"
        " number. *Won* and *lost* count seeds. A bold p says that ours is behind (p < 0.05). Two"
        " halves of a pool share rows, so the tests hold for this pool, not for all possible"
        " candidates.",
        *Bar.table(report.bars, "fails in (problem, against, trials, seeds won : lost)"),
    ]
    for problem in report.problems:
        lines += ["", *section(report, problem)]
    return "\n".join(lines) + "\n"


def section(report: OutsideReport, problem: OutsideProblem) -> list[str]:
    """A problem, the medians of its arms, and their tests."""
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
        different = report.different[name, arm]
        lines.append(f"| {ARMS[arm].label} | {ARMS[arm].sees} | {different} | {cells} |")
    tests = [test for test in report.tests if test.problem == name]
    for ours in report.arms(*OUR_ARMS):
        mine = [test for test in tests if test.ours == ours]
        heads = " | ".join(f"after {trial}: won | lost | p" for trial in at)
        lines += ["", f"| {ARMS[ours].label} against | {heads} |", "|---|" + "---:|" * 3 * len(at)]
        for other in dict.fromkeys(test.other for test in mine):
            cells = " | ".join(cells_of(test) for test in mine if test.other == other)
            lines.append(f"| {ARMS[other].label} | {cells} |")
    return lines


def cells_of(test: Versus) -> str:
    """Seeds won, seeds lost and p, in three cells; p is bold where ours is behind."""
    p = f"**{test.p:.2g}**" if test.is_behind else f"{test.p:.2g}"
    return f"{test.wins} | {test.losses} | {p}"


def plot(path: Path, report: OutsideReport) -> None:
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
            median = np.median(as_good(problem, report.best[problem.name, arm]), axis=0)
            axes.plot(np.arange(1, len(median) + 1), median, label=ARMS[arm].label, **LINES[arm])
        axes.set_yscale("log")
        axes.set_title(problem.name, fontsize=style.TITLE_PT, loc="left")
        axes.set_xlabel("trials", fontsize=style.TEXT_PT)
        axes.set_ylabel("rows as good as the best found", fontsize=style.TEXT_PT)
    runs.save_panels(figure, path, LEGEND_IN)


def as_good(problem: OutsideProblem, best: Floats) -> NDArray[np.int64]:
    """Rows of the pool that cost no more than the best found, [seeds, trials]; 1: the best row."""
    return np.searchsorted(np.sort(problem.cost), best, side="right")


if __name__ == "__main__":
    run_command(main)
