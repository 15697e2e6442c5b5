"""The cost of a walk that a machine has logged, in place of a number that somebody types."""

import math
from pathlib import Path

import numpy as np

from storage.foreign_tables import ForeignTable
from storage.inputs.errors import InputError
from taichi_nmm.result import RESULT_DTYPE, smooth_cost

TIME, POSITION = "time", "position"  # columns of a log: a clock, and metres
MOST_TRIALS = 10.0  # that a log may last: one in milliseconds would last a thousand
# where a trial has no end: milliseconds, or a clock that jumps by an hour
LONGEST_S = 3600.0
# between rows of which the others are near: 143059, 143100 is no second
LONGEST_GAP_S = 30.0
USUAL_GAPS = 10.0  # times the median
FASTEST_MPS = 30.0  # a cheetah (Sharp 1997): a position in centimetres would be faster


def cost_of_log(path: Path, duration_s: float) -> float:
    """The walker's smooth cost of a walk that was logged.

    Args:
        path: of a table with the columns `time` (seconds, or clock times) and
            `position` (m).
        duration_s: of a whole trial; infinite where it has no end.

    Raises:
        InputError: no such table; a clock that does not rise, or of other units; fewer
            than two rows; a position that is no number.
    """
    log = ForeignTable.read("log", path)
    if len(log) < 2:
        raise InputError("log", f"{len(log)} rows", "two rows or more")
    time_s = log.seconds(TIME)
    elapsed_s = float(time_s[-1])
    gaps_s = np.diff(time_s)
    most_s = MOST_TRIALS * duration_s if math.isfinite(duration_s) else LONGEST_S
    if elapsed_s > most_s:
        allowed = f"seconds, of a trial of {duration_s:g} s: up to {most_s:g}"
        raise InputError(f"log.{TIME}", f"{elapsed_s:g} from first to last", allowed)
    is_long = gaps_s > max(LONGEST_GAP_S, USUAL_GAPS * np.median(gaps_s))
    if is_long.any():
        row = int(is_long.argmax())
        allowed = "rows without such a gap; a clock in seconds, not as hhmmss"
        found = f"{gaps_s[row]:g} s after the row before"
        raise InputError(f"log.{TIME}[{row + 1}]", found, allowed)
    position_m = log.numbers(POSITION)
    is_known = np.isfinite(position_m)
    if not is_known.all():
        row = int(is_known.argmin())
        where = f"log.{POSITION}[{row}]"
        raise InputError(where, float(position_m[row]), "a finite number")
    distance_m = float(position_m[-1] - position_m[0])
    speed_mps = distance_m / elapsed_s
    if not math.isfinite(speed_mps) or abs(speed_mps) > FASTEST_MPS:
        allowed = (
            f"metres and seconds of a walk: a mean speed within {FASTEST_MPS:g} m/s"
        )
        raise InputError(f"log.{POSITION}", f"{speed_mps:g} m/s", allowed)
    walk = np.zeros(1, RESULT_DTYPE)
    walk["duration_s"] = elapsed_s
    walk["distance_m"] = distance_m
    walk["mean_speed_mps"] = speed_mps
    return float(smooth_cost(walk)[0])
