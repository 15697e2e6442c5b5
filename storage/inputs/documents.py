"""Documents of JSON values, compared."""

from typing import Any


def difference(
    document: Any, other: Any, name: str = ""
) -> tuple[str, Any, Any] | None:
    """The first field in which two documents differ, as (dotted name, value, other value)."""
    if isinstance(document, list) and isinstance(other, list):
        document, other = dict(enumerate(document)), dict(enumerate(other))
    if not (isinstance(document, dict) and isinstance(other, dict)):
        return None if document == other else (name, document, other)
    for key in dict.fromkeys([*document, *other]):
        path = f"{name}.{key}" if name else str(key)
        found = difference(document.get(key), other.get(key), path)
        if found:
            return found
    return None


def differs(
    document: dict[str, Any], known: dict[str, Any], growing: tuple[str, ...] = ()
) -> tuple[str, Any, Any] | None:
    """As `difference`; a key that one side of a `growing` dictionary lacks is no difference."""
    ours = document | {key: known.get(key, {}) | document[key] for key in growing}
    theirs = known | {key: document[key] | known.get(key, {}) for key in growing}
    return difference(ours, theirs)
