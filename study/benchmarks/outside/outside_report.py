"""What the runs on problems from outside say: medians, paired tests, and the bars to pass."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata, spearmanr

from study.benchmarks.outside.outside_arms import ARMS
from study.benchmarks.outside.outside_problem import OutsideProblem, outside_problem
from study.benchmarks.run_cache import Costs
from study.report.statistics import wilcoxon

Floats = NDArray[np.float64]

CHECKPOINTS = (5, 10, 20, 40)  # trials
OURS = tuple(name for name, arm in ARMS.items() if arm.kind == "ours")
WITHOUT_HINT = tuple(name for name, arm in ARMS.items() if arm.kind == "peer" and not arm.enqueued)
BEHIND_P, AHEAD_P = 0.05, 0.01


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


@dataclass(frozen=True)
class Bar:
    """Something that one of our arms must show, and where it does not."""

    what: str
    fails: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Whether it fails nowhere."""
        return not self.fails


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
        others = [arm for arm in self.arms() if ARMS[arm].kind != "ours"]
        return [
            self.versus(problem.name, ours, other, trial)
            for problem in self.problems
            for ours in self.arms(*OURS)
            for other in others
            for trial in self.checkpoints
        ]

    @cached_property
    def bars(self) -> list[Bar]:
        """What our arms must show, of what was run."""
        found = []
        for ours in self.arms(*OURS):
            label = ARMS[ours].label
            others = self.arms(*WITHOUT_HINT)
            rounds = [
                self.versus(problem.name, ours, other, at)
                for problem in self.problems
                for other in others
                for at in self.checkpoints
            ]
            what = f"{label}: never behind a sampler without features (p < {BEHIND_P:g})"
            found.append(Bar(what, _named([each for each in rounds if each.is_behind])))
            for at in (10, self.checkpoints[-1]):
                if "tpe" in others and at in self.checkpoints:
                    what = f"{label}: ahead of TPESampler after {at} (p < {AHEAD_P:g})"
                    of_tpe = [each for each in rounds if (each.other, each.trial) == ("tpe", at)]
                    found.append(Bar(what, _named([each for each in of_tpe if not each.is_ahead])))
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
            found.append(Bar(what, _named([each for each in rounds if each.is_behind])))
        if "ours" in self.arms() and {5, 10} <= set(self.checkpoints):
            rounds = [
                self.versus(problem.name, "ours", "ranking", 10, 5) for problem in self.problems
            ]
            what = (
                f"{ARMS['ours'].label}: after 10 not behind the ranking after 5 (p < {BEHIND_P:g})"
            )
            found.append(Bar(what, _named([each for each in rounds if each.is_behind])))
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
                {"problem": problem, "arm": arm, "runs": runs}
                for (problem, arm), runs in self.different.items()
            ],
            "tests": [asdict(test) for test in self.tests],
            "bars": [{**asdict(bar), "holds": bar.holds} for bar in self.bars],
        }  # fmt: skip


def worth(problem: OutsideProblem) -> dict[str, float]:
    """Rank correlation with the cost of each feature from its good end, and of the ranking.

    Where the feature failed, it ranks last.
    """
    columns = dict(zip(problem.feature_names, problem.ranks.T, strict=True))
    columns["ranking"] = problem.ranking
    return {name: float(spearmanr(c, problem.cost).statistic) for name, c in columns.items()}


def _named(rounds: list[Versus]) -> tuple[str, ...]:
    """Where they were: problem, other arm, trials, seeds won and lost."""
    return tuple(
        f"{each.problem}, {ARMS[each.other].label}, {each.trial} ({each.wins} : {each.losses})"
        for each in rounds
    )
