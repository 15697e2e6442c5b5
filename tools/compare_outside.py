"""Compare our samplers with Optuna's on tuning problems from outside, and write a table and a plot.

    python tools/compare_outside.py                    # the problems for tuning
    python tools/compare_outside.py --problems all     # those that are only reported as well
    python tools/compare_outside.py --seeds 3 --arms ours,tpe --problems transport-solver

The cache keeps finished runs: the same command resumes, and a run is repeated only where the code
or the numbers that made it have changed. GPSampler needs PyTorch, which this project does not
install: without it that arm is left out.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import scipy

    from study.report.numbers import wilcoxon
    from tools import benchmark
    from tools.benchmark import Bar, Costs, draw_panels, made_by
    from tools.outside import ARMS, OutsideProblem, outside_problem

NAME = "sampler-outside"
EXAMPLE = """python tools/compare_outside.py --seeds 3 --arms ours,tpe \\
    --problems transport-solver --out out/outside
"""
CHECKPOINTS = (5, 10, 20, 40)  # trials
OUR_ARMS = tuple(name for name, arm in ARMS.items() if arm.kind == "ours")
OTHERS = tuple(name for name, arm in ARMS.items() if arm.kind != "ours")
WITHOUT_HINT = tuple(name for name in OTHERS if not ARMS[name].features)
BEHIND_P, AHEAD_P = 0.05, 0.01


def main() -> None:
    options = benchmark.parse(__file__, "outside", trials=40, cache="outside")
    benchmark.publish(options, NAME, OutsideReport.of(benchmark.compared("outside", options)))


@dataclass(frozen=True)
class Versus:
    """One of our arms against another, seeds in pairs, after so many trials."""

    problem: str
    ours: str
    other: str
    trial: int  # of ours
    other_trial: int  # of the other, which may be compared after fewer
    wins: int  # seeds on which ours had found a lower cost
    losses: int  # seeds on which the other had
    p: float  # Wilcoxon's signed-rank test, two-sided, not corrected for the number of tests
    ahead: bool  # whether ours leads, by the test's sum of signed ranks, or neither does

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
    """The figures of all runs, for each (problem, arm).

    A sampler that draws nothing repeats one run, and its seeds are then no sample.
    """

    best: Costs  # least cost so far, [seeds, trials]
    different: dict[tuple[str, str], int]  # how many of the seeds' runs differ at all

    @classmethod
    def of(cls, costs: Costs) -> "OutsideReport":
        """The report of costs, [seeds, trials] for each (problem, arm)."""
        best = {key: np.minimum.accumulate(values, axis=1) for key, values in costs.items()}
        return cls(best, {key: len(np.unique(values, axis=0)) for key, values in costs.items()})

    @property
    def seeds(self) -> int:
        """Number of seeds of each arm."""
        return len(next(iter(self.best.values())))

    @property
    def checkpoints(self) -> tuple[int, ...]:
        """Trials at which arms are compared; the last are all."""
        trials = next(iter(self.best.values())).shape[1]
        return (*(at for at in CHECKPOINTS if at < trials), trials)

    @property
    def problems(self) -> list[OutsideProblem]:
        """In the order of the runs."""
        return [outside_problem(name) for name in dict.fromkeys(name for name, _ in self.best)]

    def arms(self, among: Iterable[str] = ARMS) -> list[str]:
        """The arms of some that were run, in their order."""
        run = {arm for _, arm in self.best}
        return [arm for arm in among if arm in run]

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
        ahead = bool((scipy.stats.rankdata(np.abs(more)) * np.sign(more)).sum() <= 0)
        p = wilcoxon(mine, theirs).p
        return Versus(problem, ours, other, trial, at, wins, losses, p, ahead)

    @cached_property
    def tests(self) -> list[Versus]:
        """Each of our arms against every arm that is not ours, at every checkpoint."""
        arms = product(self.arms(OUR_ARMS), self.arms(OTHERS), self.checkpoints)
        return [
            self.versus(problem.name, *each) for problem, each in product(self.problems, list(arms))
        ]

    @cached_property
    def bars(self) -> list[Bar]:
        """The bars of our arms, as far as the runs allow to check them."""
        first, last = 10, self.checkpoints[-1]
        behind, ahead = f"(p < {BEHIND_P:g})", f"(p < {AHEAD_P:g})"
        found: list[Bar] = []
        for ours in self.arms(OUR_ARMS):
            label, own = ARMS[ours].label, [each for each in self.tests if each.ours == ours]
            rounds = [each for each in own if each.other in WITHOUT_HINT]
            found += bars(f"{label}: never behind a sampler without features {behind}", rounds)
            for at in dict.fromkeys((first, last)):
                rounds = [each for each in own if (each.other, each.trial) == ("tpe", at)]
                what = f"{label}: ahead of TPESampler after {at} {ahead}"
                found += bars(what, rounds, to_lead=True)
        rounds = [t for t in self.tests if (t.ours, t.other) == ("ours-prior", "ranking")]
        what = f"{ARMS['ours-prior'].label}: never behind the ranking alone {behind}"
        found += bars(what, rounds)
        if {"ours", "ranking"} <= set(self.arms()) and {5, first} <= set(self.checkpoints):
            rounds = [self.versus(each.name, "ours", "ranking", first, 5) for each in self.problems]
            found += bars(f"ours: after {first} not behind the ranking after 5 {behind}", rounds)
        return found

    def as_dict(self) -> dict[str, Any]:
        """Medians and tests as plain values."""
        return {
            "seeds": self.seeds,
            "problems": [
                {"name": problem.name, "purpose": problem.purpose, "best": problem.best,
                 "spearman": worth(problem)}
                for problem in self.problems
            ],
            "medians": [
                {"problem": problem, "arm": arm, "trial": trial,
                 "median": self.median(problem, arm, trial)}
                for (problem, arm), trial in product(self.best, self.checkpoints)
            ],
            "different_runs": [
                {"problem": problem, "arm": arm, "runs": count}
                for (problem, arm), count in self.different.items()
            ],
            "tests": [asdict(test) for test in self.tests],
        }  # fmt: skip

    def markdown(self) -> str:
        """The document."""
        lines = [
            "# Samplers on problems from outside",
            "",
            "Do features help on tuning problems of other fields? This page has the tables, for"
            " looking up; [the benchmarks](sampler-benchmarks.md#problems-from-outside) have the"
            " conclusions. To repeat a small part:",
            "",
            "```sh",
            EXAMPLE.rstrip(),
            "```",
            "",
            made_by(),
            "",
            "## How to read the tables",
            "",
            "Each problem has a costly objective, whose cost was computed once for every candidate"
            " of a pool (`tools/data`, one Parquet file each). A seed draws half of the"
            " pool, which is then the problem of every sampler. Every sampler has"
            f" {self.seeds} seeds and its default options.",
            "",
            "*Ours* proposes candidates of the pool. Optuna's samplers propose any point, and get"
            " the cost of the nearest candidate: Euclidean distance in the unit cube, logarithmic"
            " parameters by their logarithm, a choice as one coordinate an option, 0 or 1."
            " `CmaEsSampler` draws choices at random, as everywhere in Optuna. The *ranking* is"
            " the mean rank of the features, each counted from the end that users consider good."
            f' "{ARMS["ours-prior"].label}" has the ranking as one more feature and as `prior=`.',
            "",
            "The first table of a problem has its features; a Spearman correlation near 1 means"
            " that the good end of the feature has low costs. The second table has the median over"
            " seeds of the best cost. *Information* is the input of a sampler besides its trials,"
            " *different runs* counts the seeds whose runs differ. The other tables compare ours"
            " with each sampler: *won* and *lost* count seeds, and a bold p means that ours is"
            " behind (p < 0.05). The tests are Wilcoxon's signed ranks, two-sided, paired by seed,"
            " not corrected for their number. Two halves of a pool share rows, so the tests hold"
            " for this pool, not for all possible candidates.",
            "",
            f"![Rank of the best row found against trials]({NAME}.png)",
            "",
            "The figure shows the median over seeds of the number of rows that are as good as the"
            " best row found.",
            *Bar.table(self.bars, "fails in (problem, against, trials, seeds won : lost)"),
        ]
        for problem in self.problems:
            lines += ["", *self.section(problem)]
        return "\n".join(lines) + "\n"

    def section(self, problem: OutsideProblem) -> list[str]:
        """A problem, the medians of its arms, and their tests."""
        name, at = problem.name, self.checkpoints
        best, half = np.quantile(problem.cost, [0.01, 0.5])
        worths = worth(problem)
        lines = [
            f"## {name} ({problem.purpose})",
            "",
            f"{problem.field.capitalize()}: {problem.cost_meaning}. {len(problem):,} candidates of"
            f" {len(problem.space)} parameters ({', '.join(problem.space)}). Best possible"
            f" {problem.best:.4g}, best 1 % below {best:.4g}, half below {half:.4g}.",
            "",
            "| feature | good end | meaning | Spearman with the cost, from the good end |",
            "|---|---|---|---|",
        ]
        for feature, said in problem.feature_meanings.items():
            lines.append(f"| {feature} | {said.good} | {said.meaning} | {worths[feature]:.2f} |")
        lines.append(f"| ranking | low | mean rank of these features | {worths['ranking']:.2f} |")
        head = " | ".join(f"after {trial}" for trial in at)
        lines += ["", f"| median of the best | information | different runs | {head} |",
                  "|---|---|---|" + "---|" * len(at)]  # fmt: skip
        for arm in self.arms():
            cells = " | ".join(f"{self.median(name, arm, trial):.4g}" for trial in at)
            different = self.different[name, arm]
            lines.append(f"| {ARMS[arm].label} | {ARMS[arm].sees} | {different} | {cells} |")
        for ours in self.arms(OUR_ARMS):
            head = " | ".join(f"after {trial}: won | lost | p" for trial in at)
            lines += ["", f"| {ARMS[ours].label} against | {head} |",
                      "|---|" + "---:|" * 3 * len(at)]  # fmt: skip
            for other in self.arms(OTHERS):
                pair = (name, ours, other)
                tests = [t for t in self.tests if (t.problem, t.ours, t.other) == pair]
                lines.append(f"| {ARMS[other].label} | {' | '.join(map(cells_of, tests))} |")
        return lines

    def plot(self, path: Path) -> None:
        """How many rows are as good as the best found against trials, a panel a problem."""
        curves = {}
        for (problem, arm), best in self.best.items():
            sorted_costs = np.sort(outside_problem(problem).cost)
            as_good = np.searchsorted(sorted_costs, best, side="right")  # 1: the best row
            curves[problem, arm] = np.median(as_good, axis=0)
        label = "rows as good as the best found"
        draw_panels(path, ARMS, curves, label, 3, (3.6, 3.0), legend_in=2.9, log=True)


def worth(problem: OutsideProblem) -> dict[str, float]:
    """Rank correlation with the cost of each feature from its good end, and of the ranking.

    Where the feature failed, it ranks last.
    """
    columns = dict(zip(problem.feature_meanings, problem.ranks.T, strict=True))
    columns["ranking"] = problem.ranking
    return {
        name: float(scipy.stats.spearmanr(c, problem.cost).statistic) for name, c in columns.items()
    }


def bars(what: str, rounds: list[Versus], to_lead: bool = False) -> list[Bar]:
    """A bar that fails where ours is behind, or does not lead, with these; none without rounds."""
    failed = [
        f"{each.problem}, {ARMS[each.other].label}, {each.trial} ({each.wins} : {each.losses})"
        for each in rounds
        if each.is_behind or (to_lead and not each.is_ahead)
    ]
    return [Bar(what, "; ".join(failed), not failed)] if rounds else []


def cells_of(test: Versus) -> str:
    """Seeds won, seeds lost and p, in three cells; p is bold where ours is behind."""
    p = f"**{test.p:.2g}**" if test.is_behind else f"{test.p:.2g}"
    return f"{test.wins} | {test.losses} | {p}"


if __name__ == "__main__":
    run_command(main)
