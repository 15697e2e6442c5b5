"""The one exception for everything that a user can get wrong."""

from collections.abc import Iterable

LONGEST_VALUE = 400  # characters of a value that are shown; a path may have more
MOST_LISTED = 16  # names in a line
LONGEST_ALLOWED = 1200  # characters of `allowed`, which may list all names


class InputError(ValueError):
    """Input that cannot be used: one line with the field, the value and the allowed values.

    Commands print the line and exit with code 2. Whatever the value is, the line is
    printable. The first mistake of a file has the lines of the others below its own
    (`config.read_whole`).
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        refused = f"{shortened(field)}: {_shown(value)} cannot be used; allowed: "
        super().__init__(one_line(refused + shortened(allowed, LONGEST_ALLOWED)))

    def __reduce__(self) -> tuple[type, tuple[str, object, str], dict[str, object]]:
        """The arguments again, so that it can pass from one process to another."""
        return type(self), (self.field, self.value, self.allowed), {"args": self.args}


def _shown(value: object) -> str:
    """A value as Python writes it, shortened."""
    try:
        text = repr(value)
    except Exception:  # thousands of digits or brackets, or a `__repr__` that fails
        return f"<{type(value).__name__}>"
    return shortened(text)


def shortened(text: str, longest: int = LONGEST_VALUE) -> str:
    """A text, a long one without its middle."""
    if len(text) <= longest:
        return text
    half = longest // 2
    return f"{text[:half]}...{text[-half:]}"


def listed(names: Iterable[object], near: object = "") -> str:
    """Names in a line; of many, those that look most like `near`, and how many more there are.

    A name with blanks at its ends is quoted: nobody would see them.
    """
    known = [name if name == name.strip() else repr(name) for name in map(str, names)]
    if len(known) <= MOST_LISTED:
        return ", ".join(known)
    from difflib import SequenceMatcher  # where there is a mistake

    wanted = SequenceMatcher(b=str(near).casefold()[:LONGEST_VALUE])

    def likeness(name: str) -> float:
        wanted.set_seq1(name.casefold()[:LONGEST_VALUE])
        return wanted.ratio()

    nearest = sorted(known, key=likeness, reverse=True) if str(near) else known
    return f"{', '.join(nearest[:MOST_LISTED])} and {len(known) - MOST_LISTED} more"


def one_line(text: str) -> str:
    """A text with every character escaped that a terminal cannot print."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def in_a_line(error: BaseException) -> str:
    """Kind and message of an error."""
    return one_line(shortened(f"{type(error).__name__}: {error}"))
