"""Several experiments side by side: one table, one document for programs."""

from collections.abc import Sequence

from study.experiment.arms import BEST_ARM, PAPER_ARM, Kind
from study.report.appearance import kind_of, label_of
from study.report.numbers import ArmNumbers, Numbers
from study.report.words import count_text, share_range, table

SOON = (1, 3)  # trials
ABSENT = "-"
KINDS: tuple[Kind, ...] = ("peer", "control", "ours")


def overview_text(experiments: Sequence[Numbers]) -> str:
    """Experiments in rows, arms in columns: runs with a walker, and how soon."""
    arms = arms_of(experiments)
    rows = []
    for each in experiments:
        by_name = {arm.arm: arm for arm in each.arms}
        rows.append([each.experiment, *(_cell(by_name.get(arm)) for arm in arms)])
    header = ["experiment", *(label_of(arm) for arm in arms)]
    remark = (
        "Runs with a walker (95 % interval of their share); runs whose first trial walks; one of "
        "whose first three; median trial of the first walker (`> T`: no more than half of the runs "
        "had one in T trials)."
    )
    return f"{table(header, rows)}\n\n{remark}\n"


def arms_of(experiments: Sequence[Numbers]) -> list[str]:
    """All arms: the paper's, our best, then peers, controls and others of ours."""
    known = dict.fromkeys(arm.arm for each in experiments for arm in each.arms)
    first = [arm for arm in (PAPER_ARM, BEST_ARM) if arm in known]
    rest = [arm for kind in KINDS for arm in sorted(known) if kind_of(arm) == kind]
    return first + [arm for arm in rest if arm not in first]


def _cell(arm: ArmNumbers | None) -> str:
    if arm is None:
        return ""
    median = count_text(arm.first_walker.value, arm.trials)
    soon = "; ".join(str(arm.within.get(limit, ABSENT)) for limit in SOON)
    return f"{arm.walkers} of {arm.runs} ({share_range(arm.share)}); {soon}; {median}"
