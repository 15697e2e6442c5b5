"""Numbers as words of a table: trials, proportions, intervals and p-values."""

import html
from collections.abc import Sequence

import numpy as np

from study.report.appearance import label_of
from study.report.numbers import ArmNumbers
from study.report.statistics import Interval


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; all columns but the first are aligned right."""
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, rule, *rows))


def escaped(text: str) -> str:
    """Words of a file within Markdown: no tags, no columns, one line."""
    return " ".join(html.escape(text, quote=False).replace("|", "\\|").split())


def count_text(value: float, trials: int) -> str:
    """A trial, or that it is later than all trials."""
    return f"{value:g}" if np.isfinite(value) else f"> {trials}"


def share_text(share: Interval) -> str:
    """A proportion with its interval, in per cent."""
    return f"{share.value:.0%} ({share.low:.0%} to {share.high:.0%})".replace("%", " %")


def share_range(share: Interval) -> str:
    """The interval of a proportion alone, in per cent."""
    return f"{100 * share.low:.0f} to {100 * share.high:.0f} %"


def first_walker_text(arm: ArmNumbers) -> str:
    """The median trial with its interval."""
    low, high = (
        count_text(end, arm.trials) for end in (arm.first_walker.low, arm.first_walker.high)
    )
    return f"{count_text(arm.first_walker.value, arm.trials)} ({low} to {high})"


def p_text(p: float) -> str:
    """A p-value, to two digits."""
    return "< 1e-4" if p < 1e-4 else f"{p:.2g}"


def label(arm: str) -> str:
    """The name that the command knows, and what a reader calls it."""
    return arm if label_of(arm) == arm else f"{arm} ({label_of(arm)})"


def interval_text(interval: Interval | None, form: str = ".3g") -> str:
    """An estimate with its interval; "-" where there is none."""
    if interval is None:
        return "-"
    value, low, high = (format(x, form) for x in (interval.value, interval.low, interval.high))
    return f"{value} ({low} to {high})"
