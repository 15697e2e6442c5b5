"""What files of a store say of themselves, which anybody may have edited: checked before use."""

from typing import Any

from taichi_nmm.config import Table
from taichi_nmm.errors import InputError


def check_specification(specification: Any, where: str) -> None:
    """Refuse a specification without what readers of stores take from it.

    Args:
        specification: as JSON gave it.
        where: the file that it stands in, for messages.

    Raises:
        InputError: naming the file and the key.
    """
    if not isinstance(specification, dict):
        raise InputError(where, specification, "a specification, which is an object")
    table = Table(specification, where)
    columns = [column.partition(":")[0] for column in table.texts("columns")]
    gains = table.table("gains")
    if not gains.unread or not set(gains.unread) <= set(columns):
        raise InputError(f"{where}.gains", list(gains.unread), "names of columns, one at least")
    for name in gains.unread:
        ends = gains.table(name)
        ends.number("low", high=ends.number("high"))
    table.table("simulation").number("duration_s")
    families = table.table("families")
    settings = [table, *(families.table(name) for name in families.unread)]
    if specification.get("robust") is not None:
        settings.append(table.table("robust"))
    for setting in settings:
        setting.table("terrain").text("name")
        setting.table("body").number("disturbance")
