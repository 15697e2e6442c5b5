"""Tables that other people wrote: CSV and other texts, Parquet, folders of Parquet; packed or not.

What a file is tells its content, not its name. A text's separator, decimal commas, byte
order mark and ends of lines are found out where only one reading is possible; otherwise
the file is refused, with what to do. A column is asked for as what it is needed for
(values, numbers, the seconds of a clock), and refused by name where it is something
else: a date is no number of nanoseconds.

Columns that nobody asks for may hold anything.
"""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from numpy.typing import NDArray

from storage.inputs import typed
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import PACKED_BY, is_folder, reading
from storage.tables import plain, read_any

Floats = NDArray[np.float64]

ALLOWED = "a Parquet file, a folder of them, or a text such as CSV, that exists"
PARQUET = b"PAR1"  # at the begin of such a file
ZIP = b"PK\x03\x04"  # of a spreadsheet
# of what Excel calls Unicode
BYTE_ORDER_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
PARQUET_ENDINGS = (".parquet", ".pq")
MOST_BYTES = 2 << 30  # of a file, unpacked
NO_VALUE = "__HIVE_DEFAULT_PARTITION__"  # in a folder's name, as Hive has it

LARGEST_EXACT = 2**53  # of whole numbers in float64
# the year 5138, in seconds since 1970: later readings have another unit
LATEST_S = 1e11
PER_S = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
NUMBERS = "numbers, one in each row"
NOT_WORDS = (
    "numbers, no words that look like them; in a text, all with the same decimal mark"
)
CLOCKS = "seconds, or times such as 14:30:00.25 or 2026-05-04 14:30:00.25"
VALUES = "numbers, words or flags"
GAPS = frozenset(["", *pa.csv.ConvertOptions().null_values])
DATES = "of a date or a time make a number, such as the days from the first"


class ForeignTable:
    """The columns of a table that somebody wrote.

    Attributes:
        field: that named the table, with which errors begin.
        names: of its columns.
    """

    def __init__(self, field: str, table: pa.Table) -> None:
        self.field = field
        self.names = tuple(table.column_names)
        self._table = table

    @classmethod
    def read(
        cls,
        field: str,
        path: Path,
        columns: Sequence[str] | None = None,
        words: Collection[str] = (),
        of_columns: str | None = None,
    ) -> "ForeignTable":
        """Read a file, or the Parquet files of a folder and of the folders in it.

        Folders by the name KEY=VALUE, as Hive writes them, are a column more.

        Args:
            field: that named it.
            path: of the file or folder.
            columns: those that are needed, in their order; None: all.
            words: columns of a text that are words, whatever they look like.
            of_columns: what errors of columns begin with; by default the field.

        Raises:
            InputError: no such file, no table, a text that can be read in two ways, or
                no such column.
        """
        own = of_columns or field
        if is_folder(path):
            return cls(own, _of_folder(field, path, own, columns))
        with reading(field, path, ALLOWED) as file:
            return cls(own, _of_file(file, own, columns, words))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._table)

    def values(self, name: str) -> NDArray[Any]:
        """A column of parameters or choices, [n]: floats, whole numbers, flags, or words.

        A gap is NaN among numbers and None among others. Decimals are floats, or whole
        numbers where they have no digits after the point.

        Raises:
            InputError: no such column; dates or times; lists, bytes and others.
        """
        column = self._column(name)
        kind = column.type
        if pa.types.is_null(kind):
            return np.full(len(column), np.nan)
        if pa.types.is_integer(kind) and column.null_count:
            self._require_exact(name, column)
            return plain(column.cast(pa.float64(), safe=False))
        if pa.types.is_floating(kind):
            return plain(column.cast(pa.float64()))
        if pa.types.is_integer(kind) or pa.types.is_boolean(kind) or _is_text(kind):
            return plain(column)
        if pa.types.is_temporal(kind):
            raise InputError(
                f"{self.field}.{name}", _first(column), f"{VALUES}; {DATES}"
            )
        raise InputError(f"{self.field}.{name}", str(kind), f"a column of {VALUES}")

    def numbers(self, name: str) -> Floats:
        """A column of numbers, float64 [n]; a gap is NaN, a flag 0 or 1.

        Raises:
            InputError: as `values`; words; whole numbers that no float holds.
        """
        values = self.values(name)
        if values.dtype.kind in "iu":
            self._require_exact(name, self._column(name))
        if values.dtype.kind != "O":
            return values.astype(np.float64)
        if _is_text(self._column(name).type):
            self._refuse_word(name, values.tolist())
        return values.astype(np.float64)

    def words(self, name: str) -> list[str]:
        """A column as words, [n]: numbers and times too; a gap is the empty one.

        Raises:
            InputError: no such column; lists and others.
        """
        column = self._column(name)
        try:
            found = column.cast(pa.string()).to_pylist()
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            raise InputError(
                f"{self.field}.{name}", str(column.type), "a column of words"
            ) from None
        return [word or "" for word in found]

    def seconds(self, name: str) -> Floats:
        """A clock's readings in seconds from the first one, float64 [n].

        A clock has dates and times, times of a day, durations, or numbers of seconds.

        Raises:
            InputError: as `numbers`; a gap; a reading that is no later than the one
                before; numbers that are no seconds.
        """
        column = _as_times(self._column(name))
        kind = column.type
        is_clock = pa.types.is_timestamp(kind) or pa.types.is_time(kind)
        is_clock |= pa.types.is_duration(kind)
        if column.null_count:
            row = column.is_null().to_pylist().index(True)
            raise InputError(
                f"{self.field}.{name}[{row}]", "nothing", "a time in each row"
            )
        if is_clock:
            bits = 32 if pa.types.is_time32(kind) else 64
            ticks = column.cast(pa.int32() if bits == 32 else pa.int64()).to_numpy()
            seconds = (ticks.astype(np.int64) - int(ticks[:1].sum())) / PER_S[kind.unit]
            # of a text, which has 00:30
            if kind == pa.time32("s") and not (ticks % 60).any():
                allowed = "times with seconds, such as 0:00:30: these may be minutes and seconds"
                raise InputError(f"{self.field}.{name}[0]", str(column[0]), allowed)
        elif _is_text(kind):
            raise InputError(f"{self.field}.{name}[0]", str(column[0]), CLOCKS)
        else:
            read = self.numbers(name)
            for row in np.flatnonzero(~np.isfinite(read) | (np.abs(read) > LATEST_S))[
                :1
            ].tolist():
                allowed = "seconds, finite numbers; these may be milliseconds, or less"
                raise InputError(
                    f"{self.field}.{name}[{row}]", float(read[row]), allowed
                )
            seconds = read - read[:1].sum()
        for row in (1 + np.flatnonzero(np.diff(seconds) <= 0.0)[:1]).tolist():
            allowed = (
                "times that rise from row to row; of a log past midnight, with the date"
            )
            raise InputError(
                f"{self.field}.{name}[{row}]", str(column[row].as_py()), allowed
            )
        return np.asarray(seconds)

    def _column(self, name: str) -> pa.ChunkedArray:
        _require_columns(self.field, [name], self.names)
        column = self._table[name]
        kind = column.type
        if pa.types.is_dictionary(kind):
            return column.cast(kind.value_type)
        if pa.types.is_string_view(kind):
            return column.cast(pa.string())
        if not pa.types.is_decimal(kind):
            return column
        if kind.scale > 0:
            return column.cast(pa.float64())
        try:
            return column.cast(pa.int64())
        except pa.ArrowInvalid:
            allowed = "whole numbers within 2^63; longer ones, such as ids, as words"
            raise InputError(f"{self.field}.{name}", str(kind), allowed) from None

    def _require_exact(self, name: str, column: pa.ChunkedArray) -> None:
        """Refuse whole numbers of which a float would make others."""
        ends = pc.min_max(column).as_py()
        for value in ends.values():
            if value is not None and abs(value) > LARGEST_EXACT:
                allowed = "whole numbers up to 2^53, which a float holds"
                raise InputError(f"{self.field}.{name}", value, allowed)

    def _refuse_word(self, name: str, words: list[str | None]) -> NoReturn:
        """Raise the error of a column of words where numbers are needed, which says what to do."""
        odd = [
            row
            for row, word in enumerate(words)
            if word is None or not typed.WITH_POINT.fullmatch(word.strip())
        ]
        wrong = [
            row for row in odd if words[row] is not None and words[row] not in GAPS
        ]
        either = [
            row
            for row, word in enumerate(words)
            if re.fullmatch(typed.EITHER_BY_POINT, (word or "").strip())
        ]
        row = (wrong or either or [0])[0]
        word = str(words[row])
        field = f"{self.field}.{name}[{row}]"
        if not wrong:
            mend = f"{typed.mend(word)}; " if either else ""
            raise InputError(field, word, mend + NOT_WORDS)
        if wrong == [0] and len(words) > len(odd) and not typed.is_meant(word):
            units = "this looks like a row of units below the names: take it out"
            raise InputError(field, word, f"{NUMBERS}; {units}")
        raise InputError(field, word, typed.mend(word) or NUMBERS)


def _require_columns(field: str, wanted: Sequence[str], known: Sequence[str]) -> None:
    """Refuse a name that no column has, or that several have."""
    for name in wanted:
        if name not in known:
            raise InputError(field, name, f"one of the columns {listed(known, name)}")
        if known.count(name) > 1:
            raise InputError(
                field, name, f"a name of one column, not of {known.count(name)}"
            )


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _as_times(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Words that are all times, with dates or of a day, such as 14:30:00.010; else as they are."""
    if not _is_text(column.type) or not pc.all(pc.match_substring(column, ":")).as_py():
        return column
    # as Python's logging has it
    words = pc.replace_substring(column.cast(pa.string()), ",", ".")
    of_a_day = pc.binary_join_element_wise("1970-01-01", words, " ")
    for written, kind in (
        (words, pa.timestamp("ns")),
        (words, pa.timestamp("ns", "UTC")),  # with a zone
        (of_a_day, pa.timestamp("ns")),
    ):
        try:
            return written.cast(kind)
        except pa.ArrowInvalid:
            continue
    return column


def _first(column: pa.ChunkedArray) -> str:
    """The first value that is there, as a word."""
    known = column.drop_null()
    return str(known[0]) if len(known) else str(column.type)


def _of_file(
    file: Path, own: str, columns: Sequence[str] | None, words: Collection[str]
) -> pa.Table:
    """The columns of a file that are needed."""
    packed_by = PACKED_BY.get(file.suffix.lower())
    named = file.with_suffix("") if packed_by else file
    with (
        import_module(packed_by).open(file) if packed_by else file.open("rb") as stream
    ):
        begin: bytes = stream.read(len(PARQUET))
        if begin == PARQUET and not packed_by:
            return _of_parquet(file, own, columns)
        content: bytes = begin + stream.read(MOST_BYTES)
    if len(content) > MOST_BYTES:
        raise ValueError(f"longer than {MOST_BYTES >> 30} GiB")
    if begin == PARQUET:
        return _of_parquet(pa.BufferReader(content), own, columns)
    if begin == ZIP:
        raise ValueError("it is a spreadsheet or a ZIP archive: save the table as CSV")
    if named.suffix.lower() in PARQUET_ENDINGS:
        raise ValueError("no Parquet file: it does not begin with PAR1")
    found = _of_text(content, words)
    if columns is None:
        return found
    _require_columns(own, columns, found.column_names)
    return found.select(list(columns))


def _of_parquet(
    file: Path | pa.BufferReader, own: str, columns: Sequence[str] | None
) -> pa.Table:
    if columns is not None:
        _require_columns(own, columns, _names(file))
        columns = list(dict.fromkeys(columns))
    return read_any(file, columns)


def _names(file: Path | pa.BufferReader) -> list[str]:
    """The columns of a Parquet file."""
    from pyarrow import parquet  # slow to load, and a text does without

    return list(parquet.read_schema(file).names)


def _of_text(content: bytes, words: Collection[str]) -> pa.Table:
    encoding = BYTE_ORDER_MARKS.get(content[:2], "utf-8-sig")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        raise ValueError(
            f"no text in UTF-8 (byte {error.start}): save it as CSV UTF-8"
        ) from None
    if "\0" in text[: typed.SAMPLE_CHARACTERS]:
        raise ValueError("it is no text")
    if text.startswith("sep="):  # by which a file tells Excel its separator
        text = text.partition("\n")[2]
    mark = typed.separator(text)
    # a spreadsheet ends in rows of no cells
    text = re.sub(rf"[\r\n][{mark}\s]*\Z", "\n", text)
    if mark == typed.BLANKS:
        mark, text = (
            "\t",
            "\n".join("\t".join(line.split()) for line in text.splitlines()),
        )
    source = text.encode()
    found = _parsed(source, mark, ".", words)
    if mark != "," and _has_decimal_commas(found, words):
        found = _parsed(source, mark, ",", words)
    names = [name for name in found.column_names if _may_be_long(found, name)]
    if names:
        as_words = _parsed(source, mark, ".", [*words, *names])
        found = _with(found, as_words, filter(partial(_has_long, as_words), names))
    elif mark == ";":
        names = [name for name in found.column_names if _is_float(found, name)]
        as_words = _parsed(source, mark, ".", [*words, *names])
        found = _with(found, as_words, _with_unclear_points(as_words, names))
    return found


def _with(table: pa.Table, other: pa.Table, names: Iterable[str]) -> pa.Table:
    """The table with some columns of another one."""
    for name in names:
        table = table.set_column(table.column_names.index(name), name, other[name])
    return table


def _with_unclear_points(words: pa.Table, names: Sequence[str]) -> list[str]:
    """Columns whose points may be marks between thousands, as those of a whole file may.

    Who parts columns by semicolons often writes 1.234 for 1234.
    """
    found = list[str]()
    for name in names:
        cells = pc.utf8_trim_whitespace(words[name])
        with_point = pc.match_substring(cells, ".")
        may_be_either = pc.match_substring_regex(cells, f"^{typed.EITHER_BY_POINT}$")
        if pc.any(pc.and_not(with_point, may_be_either)).as_py():
            return []
        if pc.any(may_be_either).as_py():
            found.append(name)
    return found


def _parsed(source: bytes, mark: str, decimal: str, words: Collection[str]) -> pa.Table:
    """The columns of a text, of the types that Arrow finds; `words` are strings."""
    found = pa.csv.read_csv(
        pa.BufferReader(source),
        parse_options=pa.csv.ParseOptions(delimiter=mark, newlines_in_values=True),
        convert_options=pa.csv.ConvertOptions(
            decimal_point=decimal, column_types={name: pa.string() for name in words}
        ),
    )
    return found.rename_columns([name.strip() for name in found.column_names])


def _has_decimal_commas(table: pa.Table, words: Collection[str]) -> bool:
    """Whether a column has numbers with decimal commas, and but for gaps nothing else.

    Where all of a file's may as well be marks between thousands, they stay words, which
    are refused when numbers are needed.
    """
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name in words or not _is_text(column.type):
            continue
        cells = pc.utf8_trim_whitespace(column)
        cells = cells.filter(pc.invert(pc.is_in(cells, pa.array(sorted(GAPS)))))
        with_comma = pc.match_substring_regex(cells, f"^{typed.WITH_COMMA}$")
        may_be_either = pc.match_substring_regex(cells, f"^{typed.EITHER}$")
        is_whole = pc.match_substring_regex(cells, f"^[+-]?[0-9]+{typed.EXPONENT}$")
        is_alike = pc.all(pc.or_(with_comma, is_whole)).as_py()
        if is_alike and pc.any(pc.and_not(with_comma, may_be_either)).as_py():
            return True
    return False


def _is_float(table: pa.Table, name: str) -> bool:
    is_one = table.column_names.count(name) == 1
    return is_one and bool(pa.types.is_floating(table[name].type))


def _may_be_long(table: pa.Table, name: str) -> bool:
    """Whether a column of floats may have been whole numbers of more digits than Arrow reads."""
    if not _is_float(table, name):
        return False
    most = pc.max(pc.abs(table[name])).as_py()  # a scalar of Arrow would load pandas
    return most is not None and most >= LARGEST_EXACT


def _has_long(words: pa.Table, name: str) -> bool:
    is_long = pc.match_substring_regex(words[name], r"^\s*[+-]?[0-9]{16,}\s*$")
    return bool(pc.any(is_long).as_py())


def _of_folder(
    field: str, folder: Path, own: str, columns: Sequence[str] | None
) -> pa.Table:
    """The rows of all Parquet files of a folder, in the order of their names."""
    files = sorted(_tables_of(folder))
    if not files:
        raise InputError(field, str(folder), ALLOWED)
    keys = [_keys(file.parent.relative_to(folder)) for file in files]
    for each in keys:
        if each.keys() != keys[0].keys():
            wanted_keys = ", ".join(keys[0]) or "no key"
            allowed = f"a folder whose files all lie in KEY=VALUE of {wanted_keys}"
            raise InputError(field, str(folder), allowed)
    of_keys = {key: _as_numbers([each[key] for each in keys]) for key in keys[0]}
    tables = []
    for place, file in enumerate(files):
        wanted = None
        with reading(field, file, ALLOWED):
            known = [*_names(file), *of_keys]
            if columns is not None:
                _require_columns(own, columns, known)
                wanted = [name for name in columns if name not in of_keys]
            table = _of_parquet(file, own, wanted)
            for key, values in of_keys.items():
                column = values.take(pa.array(np.full(len(table), place)))
                table = table.append_column(key, column)
        tables.append(table if columns is None else table.select(list(columns)))
    with reading(field, files[0], "files of the same columns, if there are several"):
        return pa.concat_tables(tables, promote_options="permissive")


def _tables_of(folder: Path) -> Iterator[Path]:
    """The Parquet files of a folder, and of folders in it by the name KEY=VALUE."""
    for path in folder.iterdir():
        if path.is_dir():
            if "=" in path.name:
                yield from _tables_of(path)
        elif path.suffix.lower() == ".parquet" and not path.name.startswith("."):
            yield path


def _keys(folder: Path) -> dict[str, str | None]:
    """The values that the names of folders give, by key."""
    pairs = [part.split("=", 1) for part in folder.parts]
    return {
        unquote(key): None if value == NO_VALUE else unquote(value)
        for key, value in pairs
    }


def _as_numbers(words: Sequence[str | None]) -> pa.Array:
    """Words as whole numbers, or as numbers, if all of them are; else as they are."""
    column = pa.array(words, pa.string())
    for kind in (pa.int64(), pa.float64()):
        try:
            return column.cast(kind)
        except pa.ArrowInvalid:
            continue
    return column
