"""Parameters that a user fixed in a trial, the others being left to the sampler of a table."""

from collections.abc import Mapping
from typing import Any

from study.sampler.rows import Rows
from taichi_nmm.errors import InputError


def no_row_has(rows: Rows, fixed: Mapping[str, Any]) -> InputError:
    """What is wrong with values, at least one, that no row has which could be proposed."""
    name, values = ", ".join(fixed), tuple(fixed.values())
    what = "values that a row of the table has together"
    if rows.having(fixed).any():
        what = "values of a row that has not been tried"
    elif len(fixed) == 1:
        near = _nearest_value(rows, name, values[0])
        such = "" if near is None else f", such as {near!r}"
        what = f"a value that a row of the table has{such}"
    allowed = f"{what}; or all parameters, in enqueue_trial"
    return InputError(name, values[0] if len(values) == 1 else values, allowed)


def _nearest_value(rows: Rows, name: str, value: Any) -> Any:
    """The value of a row that is nearest to a number; None for what is no number, nor a choice."""
    column = rows.names.index(name)
    number = rows.space.number(column, value)
    if number is None:
        return None
    return rows.as_parameters(int(abs(rows.parameters[:, column] - number).argmin()))[name]
