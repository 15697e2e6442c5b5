"""Compare our samplers with others on tuning problems from outside, and write tables.

    python tools/compare_outside.py                    # the problems for tuning
    python tools/compare_outside.py --problems all     # those that are only reported as well
    python tools/compare_outside.py --seeds 3 --arms ours,tpe --problems transport-solver

The cache keeps finished runs: the same command resumes, and a run is repeated only
where the code or the numbers that made it have changed. GPSampler needs PyTorch, which
this project does not install: without it this arm is left out.
"""

from argparse import Namespace
from collections.abc import Iterable, Mapping
from itertools import product
from typing import NamedTuple

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import scipy

    from study.report.numbers import wilcoxon
    from tools import outside
    from tools.outside import ARMS, PROBLEMS, OutsideRun, outside_problem
    from tools.page import write_page
    from tools.runs import Floats, RunOptions, chosen, execute, runnable

TITLE = "Samplers on problems from outside"
CHECKPOINTS = (5, 10, 20, 30, 40)  # trials
OUR_ARMS = [name for name, arm in ARMS.items() if arm.ours]
OTHERS = [name for name, arm in ARMS.items() if not arm.ours]
WITHOUT_HINT = [name for name in OTHERS if ARMS[name].sees == outside.NOTHING]
BEHIND_P, AHEAD_P = 0.05, 0.01


def main() -> None:
    options = parse()
    keys = list(product(options.problems, options.arms))
    runs = [
        OutsideRun(*key, seed, options.batches)
        for key in keys
        for seed in range(options.seeds)
    ]
    costs, seconds = execute(runs, options.cache, options.processes)
    shape = (len(keys), options.seeds, options.trials)
    medians = np.median(seconds.reshape(shape[:2]), axis=1)
    found = (
        dict(zip(keys, values, strict=True))
        for values in (costs.reshape(shape), medians)
    )
    name, title = "sampler-outside", TITLE
    if options.batch > 1:
        name, title = (
            f"{name}-by-{options.batch}",
            f"{title}, {options.batch} at a time",
        )
    options.out.mkdir(parents=True, exist_ok=True)
    write_page(options.out / f"{name}.md", title, Comparison(*found).figures())


def parse() -> Namespace:
    """The options, with lists of problems and of arms that this machine can run."""
    parser = RunOptions(__file__, seeds=30, trials=40, cache="outside")
    parser.add_argument("--arms", help="all")
    known = f"{', '.join(outside.GROUPS)}, or some of {','.join(PROBLEMS)}; %(default)s"
    parser.add_argument("--problems", default="tuning", help=known)
    found = parser.parse_args()
    found.problems = outside.GROUPS.get(found.problems) or chosen(
        "problems", found.problems, PROBLEMS
    )
    arms = chosen("arms", found.arms or ",".join(ARMS), [*ARMS])
    found.arms = runnable(arms, ARMS)
    return found


class Versus(NamedTuple):
    """One of our arms against another, seeds in pairs.

    Attributes:
        problem: its name.
        other: the other arm.
        wins: seeds on which ours had found a lower cost.
        losses: seeds on which the other had.
        p: Wilcoxon's signed-rank test, two-sided, not corrected for the number of
            tests.
        is_behind: whether the other leads by the test's sum of signed ranks, beyond
            chance.
        is_ahead: whether ours leads, well beyond chance.
    """

    problem: str
    other: str
    wins: int
    losses: int
    p: float
    is_behind: bool
    is_ahead: bool


class Comparison:
    """The figures of all runs: for each (problem, arm) costs [seeds, trials], median seconds.

    A sampler that draws nothing repeats one run, and its seeds are then no sample.
    """

    def __init__(
        self,
        costs: Mapping[tuple[str, str], Floats],
        seconds: Mapping[tuple[str, str], float],
    ) -> None:
        self.seconds = seconds
        self.best = {
            key: np.minimum.accumulate(values, axis=1) for key, values in costs.items()
        }
        self.different = {
            key: len(np.unique(values, axis=0)) for key, values in costs.items()
        }
        self.problems = list(dict.fromkeys(problem for problem, _ in costs))
        trials = next(iter(costs.values())).shape[1]
        self.checkpoints = [*(at for at in CHECKPOINTS if at < trials), trials]

    def arms(self, among: Iterable[str] = ARMS) -> list[str]:
        """The arms of some that were run, in their order."""
        return [arm for arm in among if (self.problems[0], arm) in self.best]

    def versus(
        self,
        problem: str,
        ours: str,
        other: str,
        trial: int,
        other_trial: int | None = None,
    ) -> Versus:
        """One of our arms against another; both after `trial`, unless the other has a number."""
        mine = self.best[problem, ours][:, trial - 1]
        theirs = self.best[problem, other][:, (other_trial or trial) - 1]
        more = (mine - theirs)[mine != theirs]
        leads = bool((scipy.stats.rankdata(np.abs(more)) * np.sign(more)).sum() <= 0)
        wins, losses = int((more < 0).sum()), int((more > 0).sum())
        p = wilcoxon(mine, theirs).p
        behind, ahead = not leads and p < BEHIND_P, leads and p < AHEAD_P
        return Versus(problem, other, wins, losses, p, behind, ahead)

    def bars(self) -> dict[str, list[Versus]]:
        """Where each bar of our arms fails; only bars that the runs allow to check."""
        found: dict[str, list[Versus]] = {}

        def check(
            what: str,
            ours: str,
            others: Iterable[str],
            trials: Iterable[int],
            other_trial: int | None = None,
            to_lead: bool = False,
        ) -> None:
            rounds = [
                self.versus(problem, ours, other, at, other_trial)
                for problem, other, at in product(
                    self.problems, self.arms(others), trials
                )
                if at in self.checkpoints
            ]
            if rounds and self.arms([ours]):
                failed = [
                    each for each in rounds if each.is_behind or to_lead > each.is_ahead
                ]
                found[f"{ARMS[ours].label}: {what}"] = failed

        behind, first, every = f"(p < {BEHIND_P:g})", 10, self.checkpoints
        for ours in self.arms(OUR_ARMS):
            check(
                f"never behind a sampler without features {behind}",
                ours,
                WITHOUT_HINT,
                every,
            )
            for at in dict.fromkeys((first, every[-1])):
                what = f"ahead of TPESampler after {at} (p < {AHEAD_P:g})"
                check(what, ours, ["tpe"], [at], to_lead=True)
            if ours == "ours-ranked":
                check(
                    f"never behind the ranking alone {behind}", ours, ["ranking"], every
                )
            elif 5 in every:
                what = f"after {first} not behind the ranking after 5 {behind}"
                check(what, ours, ["ranking"], [first], 5)
        return found

    def figures(self) -> list[str]:
        """The bars, and a section for each problem."""
        lines = [
            "## Bars",
            "",
            "A bar holds if it fails on no problem. A row with **no** has a problem on which the"
            " bar fails.",
            "",
            "| bar | holds | fails on | against | seeds won | seeds lost |",
            "|---|---|---|---|---:|---:|",
        ]
        for what, failed in self.bars().items():
            lines += [f"| {what} | yes | | | | |"] if not failed else []
            for each in failed:
                cells = (each.problem, ARMS[each.other].label, each.wins, each.losses)
                lines.append(f"| {what} | **no** | {' | '.join(map(str, cells))} |")
        for name in self.problems:
            lines += ["", *self.section(name)]
        return lines

    def section(self, name: str) -> list[str]:
        """A problem, the medians of its arms, and their tests."""
        problem, at = outside_problem(name), self.checkpoints
        best, half = np.quantile(problem.cost, [0.01, 0.5])
        lines = [
            f"## {name} ({problem.purpose})",
            "",
            f"{problem.field.capitalize()}: {problem.cost_meaning}. {len(problem):,} candidates of"
            f" {len(problem.space)} parameters ({', '.join(problem.space)}). Best possible"
            f" {problem.cost.min():.4g}, best 1 % below {best:.4g}, half below {half:.4g}.",
            "",
            "| feature | good end | meaning | Spearman with the cost, from the good end |",
            "|---|---|---|---|",
        ]
        ranking = outside.Feature("low", "mean rank of these features")
        for (feature, said), ranks in zip(
            (*problem.feature_meanings.items(), ("ranking", ranking)),
            (*problem.ranks.T, problem.ranking),  # a feature that failed ranks last
            strict=True,
        ):
            worth = scipy.stats.spearmanr(ranks, problem.cost).statistic
            lines.append(f"| {feature} | {said.good} | {said.meaning} | {worth:.2f} |")
        head = " | ".join(f"after {trial}" for trial in at)
        lines += [
            "",
            f"| median of the best | information | different runs | s a run | {head} |",
            "|---|---|---|---|" + "---|" * len(at),
        ]
        for arm in self.arms():
            medians = np.median(self.best[name, arm], axis=0)
            cells = " | ".join(f"{medians[trial - 1]:.4g}" for trial in at)
            different = self.different[name, arm]
            label = f"{ARMS[arm].label} | {ARMS[arm].sees}"
            lines.append(
                f"| {label} | {different} | {self.seconds[name, arm]:.2g} | {cells} |"
            )
        for ours in self.arms(OUR_ARMS):
            head = " | ".join(f"after {trial}: won | lost | p" for trial in at)
            lines += [
                "",
                f"| {ARMS[ours].label} against | {head} |",
                "|---|" + "---:|" * 3 * len(at),
            ]
            for other in self.arms(OTHERS):
                tests = [self.versus(name, ours, other, trial) for trial in at]
                lines.append(
                    f"| {ARMS[other].label} | {' | '.join(map(cells_of, tests))} |"
                )
        return lines


def cells_of(test: Versus) -> str:
    """Seeds won, seeds lost and p, in three cells; p is bold where ours is behind."""
    p = f"**{test.p:.2g}**" if test.is_behind else f"{test.p:.2g}"
    return f"{test.wins} | {test.losses} | {p}"


if __name__ == "__main__":
    run_command(main)
