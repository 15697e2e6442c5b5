"""An experiment as one table: an arm a row, what it reached and how it fares beside the paper's."""

from study.experiment.arms import PAPER_ARM
from study.report.numbers import COMPARED_AFTER, ArmNumbers, Comparison, Numbers
from study.report.words import first_walker_text, p_text, share_range, table

SHOWN_WITHIN = (1, 3, 10, 30, 60)  # trials
ABSENT = "-"


def condensed_table(experiment: Numbers) -> str:
    """The arms, those first that have a walker in most runs, then the soonest; Markdown."""
    against = {each.arm: each for each in experiment.comparisons}
    arms = sorted(experiment.arms, key=lambda arm: (-arm.walkers, arm.first_walker.value))
    header = [
        "arm",
        "runs with a walker",
        "first walker, median trial",
        f"within {', '.join(map(str, SHOWN_WITHIN))}",
        f"best cost after {COMPARED_AFTER}, median",
        f"less that of `{PAPER_ARM}`, paired; p",
    ]
    return table(header, [_row(arm, against.get(arm.arm)) for arm in arms])


def _row(arm: ArmNumbers, against: Comparison | None) -> list[str]:
    cost = arm.cost_after.get(COMPARED_AFTER)
    return [
        f"`{arm.arm}`",
        f"{arm.walkers} of {arm.runs} ({share_range(arm.share)})",
        first_walker_text(arm),
        ", ".join(str(arm.within.get(limit, ABSENT)) for limit in SHOWN_WITHIN),
        ABSENT if cost is None else f"{cost.value:.4g}",
        ABSENT if against is None else _difference(against),
    ]


def _difference(against: Comparison) -> str:
    gap = against.difference
    return f"{gap.value:.3g} ({gap.low:.3g} to {gap.high:.3g}); {p_text(against.cost_p_holm)}"
