"""Numbers and tables as people and their spreadsheets write them.

Half of Europe writes 0,92 for 0.92, and parts the columns of a file by semicolons for
it. What can mean one thing alone is read. What can mean two is refused, with the way to
write it.
"""

import csv
import math
import re
from collections.abc import Sequence
from io import StringIO

from storage.inputs.errors import InputError

EXPONENT = r"([eE][+-]?[0-9]{1,4})?"
WITH_POINT = re.compile(rf"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+){EXPONENT}")
WITH_COMMA = rf"[+-]?[0-9]*,[0-9]+{EXPONENT}"
EITHER = r"[+-]?[1-9][0-9]{0,2}(,[0-9]{3})+"  # 1,234: a decimal comma, or a mark of thousands
EITHER_BY_POINT = EITHER.replace("(,", r"(\.")
MARKS = "., '\N{RIGHT SINGLE QUOTATION MARK}\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}"
# in any way of writing
MEANT = re.compile(rf"[+-]?[.,]?[0-9][0-9{MARKS}]*([eE][+-]?[0-9]+)?")
CLOCK = re.compile(
    r"[0-9]{1,4}([-/.])[0-9]{1,2}\1[0-9]{1,4}([T ,].*)?|[0-9]{1,2}:[0-9]{2}.*"
)

SEPARATORS = "\t;,"
BLANKS = " "  # a run of them parts two columns
SAMPLE_CHARACTERS = 1 << 16  # of a text, by which its columns are told apart
DECIMAL_COMMAS = "decimal commas need columns that are parted by ;"


def number(field: str, word: str) -> float:
    """The number that somebody typed, with a decimal point or a decimal comma.

    Raises:
        InputError: no number, one that no float can hold, or one that may mean two.
    """
    text = word.strip().replace("\N{MINUS SIGN}", "-")
    if re.fullmatch(WITH_COMMA, text) and not re.fullmatch(EITHER, text):
        text = text.replace(",", ".")
    if not WITH_POINT.fullmatch(text):
        raise InputError(field, word, mend(text) or "a number, such as 0.92")
    value = float(text)
    # 1e-400
    is_lost = value == 0.0 and re.search("[1-9]", text.lower().partition("e")[0])
    if is_lost or not math.isfinite(value):
        raise InputError(field, word, "a finite number")
    return value


def is_meant(word: object) -> bool:
    """Whether a word is meant for a number, in whatever way it is written."""
    return isinstance(word, str) and MEANT.fullmatch(word.strip()) is not None


def is_clock(word: object) -> bool:
    """Whether a word begins as a date or a time of the day."""
    return isinstance(word, str) and CLOCK.fullmatch(word.strip()) is not None


def mend(word: str) -> str:
    """How to write a number that cannot be read as it is; "": it is none."""
    if not is_meant(word):
        return ""
    text = word.strip()
    marks = re.findall(r"[.,]", text)
    plain = re.sub(r"[^0-9eE+-]", "", text)
    if len(marks) == 1 and re.fullmatch(f"{EITHER}|{EITHER_BY_POINT}", text):
        # in a file, 1.234 may be two numbers, too
        clear = f"{text}0" if marks == ["."] else text.replace(",", ".")
        meant = f"{plain} or {clear}, whichever is meant"
    elif not marks or (len(marks) > 1 and len(set(marks)) == 1):
        meant = plain
    else:
        place = max(text.rfind("."), text.rfind(","))  # of the decimal mark
        whole, fraction = (
            re.sub(f"[{MARKS}]", "", part) for part in (text[:place], text[place:])
        )
        meant = f"{whole}.{fraction}"
    return f"{meant}: a decimal point, and no marks between thousands"


def with_points(cells: Sequence[str]) -> list[str]:
    """Cells of a text, in which decimal commas are points: where none may mean something else.

    Raises:
        ValueError: all of the commas may be marks between thousands, or there are
            points too.
    """
    commas = [cell for cell in cells if "," in cell]
    if not commas:
        return list(cells)
    is_clear = any(
        re.fullmatch(WITH_COMMA, c) and not re.fullmatch(EITHER, c) for c in commas
    )
    if not is_clear or any("." in cell for cell in cells):
        raise ValueError(f"{commas[0]} may be two numbers: write {mend(commas[0])}")
    return [cell.replace(",", ".") for cell in cells]


def separator(text: str) -> str:
    """What parts the columns of a text: a tab, a semicolon, a comma, or blanks.

    Its first row has two cells or more, and each other row has as many. Where nothing
    parts the rows so, there is one column.

    Raises:
        ValueError: rows of different lengths, or two separators that both fit.
    """
    if len(text) > SAMPLE_CHARACTERS:
        text = text[:SAMPLE_CHARACTERS].rpartition("\n")[0]
    parted = {mark: _cells(text, mark) for mark in SEPARATORS}
    fitting = [mark for mark, rows in parted.items() if _is_even(rows)]
    # a mark within numbers, such as a decimal comma, may part rows evenly too
    if len(fitting) > 1:
        fitting = [
            mark for mark in fitting if not _cuts_words(parted[mark], fitting, mark)
        ]
        if len(fitting) != 1:
            raise ValueError("columns that may be parted by two of tabs, ; and ,")
    if fitting:
        return fitting[0]
    widest = max(SEPARATORS, key=lambda mark: max(map(len, parted[mark])))
    first, *others = parted[widest]
    by_blanks = [line.split() for line in text.splitlines() if line.strip()]
    may_be_blanks = len(first) == 1 or widest == "\t"
    if may_be_blanks and by_blanks and _is_even(by_blanks):
        return BLANKS
    for place, row in enumerate(others, start=2):
        if len(row) != len(first):
            cells = (
                f"row {place} has {len(row)} cells, and row 1, of names, {len(first)}"
            )
            raise ValueError(f"{cells}; {DECIMAL_COMMAS}")
    return SEPARATORS[-1]


def _cells(text: str, mark: str) -> list[list[str]]:
    """The cells of rows that are not empty, of one row at least."""
    try:
        rows = list(csv.reader(StringIO(text, newline=None), delimiter=mark))
    except csv.Error as error:
        raise ValueError(str(error)) from None
    return [row for row in rows if row] or [[""]]


def _is_even(rows: Sequence[Sequence[str]]) -> bool:
    return len(rows[0]) > 1 and all(len(row) == len(rows[0]) for row in rows)


def _cuts_words(rows: Sequence[Sequence[str]], marks: Sequence[str], own: str) -> bool:
    """Whether a cell has another of the marks within, and is no number that may have it."""
    others = [mark for mark in marks if mark != own]
    cells = [
        cell for row in rows for cell in row if any(mark in cell for mark in others)
    ]
    return not all(map(is_meant, cells))
