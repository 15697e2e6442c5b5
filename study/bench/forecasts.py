"""What a bench lets expect before its first trial, kept in its database.

`study.sampler.forecast` lets the worlds of the candidates take the machine's place. What
came of them is kept by the candidates' digest and all else that it follows from, so that
it is computed once.
"""

import hashlib
import json
from contextlib import suppress
from dataclasses import asdict
from typing import Any

from storage.databases.files import read_errors
from storage.inputs.errors import InputError
from storage.inputs.version import __version__
from study.bench.bench import Bench
from study.bench.limits import by_limit
from study.sampler.forecast import (
    Forecast,
    Report,
    Robot,
    forecast,
)
from study.sampler.rows import Rows

QUICK = 50_000  # rows times worlds that are looked at: some seconds
KEY = "forecast"  # of the attribute, before the digest


def is_quick(rows: Rows) -> bool:
    """Whether a forecast takes seconds, and not a minute."""
    return rows.worlds is not None and rows.worlds.costs.size <= QUICK


def known_forecast(bench: Bench) -> Forecast | None:
    """The forecast that was computed before; None: none was."""
    kept = bench.journal.kept(_key(bench))
    if kept is None:
        return None
    with read_errors(bench.plan.url):  # which somebody may have edited
        like, strange = (
            tuple(Robot(**robot) for robot in kept[kind])
            for kind in ("like", "strange")
        )
        return Forecast(kept["trials"], like, strange)


def forecast_of(bench: Bench, report: Report | None = None) -> Forecast:
    """What to expect of a machine like the worlds, with the options of the bench's sampler.

    [safety] counts for nothing here: it follows from trials.

    Args:
        bench: that was begun.
        report: is told of each robot that is done, and of how many.

    Raises:
        InputError: the candidates tell nothing of trials.
    """
    known = known_forecast(bench)
    if known is None:
        known = forecast(bench.candidates, **_options(bench), report=report)
        with suppress(InputError):  # where nothing may be written, it is computed again
            bench.journal.keep(_key(bench), asdict(known))
    return known


def _options(bench: Bench) -> dict[str, Any]:
    plan = bench.plan
    return {
        "success": plan.goal.success,
        "maximise": plan.goal.maximise,
        "allowed_risk": by_limit(plan.allowed, plan.columns) or None,
        "seed": plan.seed,
    }


def _key(bench: Bench) -> str:
    rows = bench.candidates.rows
    broken = {
        name: hashlib.sha256(limit.costs.tobytes()).hexdigest()
        for name, limit in rows.limits.items()
    }
    told = [bench.candidates.digest, broken, _options(bench), __version__]
    text = json.dumps(told, sort_keys=True)
    return f"{KEY} {hashlib.sha256(text.encode()).hexdigest()}"
