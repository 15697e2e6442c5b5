"""A store: names and types of its columns, its manifest, and its shards, one alone or merged."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.commit import commit_json
from storage.inputs import checks
from storage.inputs.config import Table
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import is_folder, is_there, json_document, reading
from storage.simulator import (
    PARAMETERS_KEY,
    SIMULATOR_KEY,
    SIMULATORS,
    WALKER,
    Simulator,
    known_simulator,
)
from storage.tables import (
    FORMAT,
    document_hash,
    file_hash,
    plain,
    read_about,
    read_columns,
    write_table,
)

MANIFEST_NAME = "manifest.json"
SHARD_PATTERN = "part-*.parquet"
FOOTER_NEEDS = {"format", "rows", "shard", "specification", "specification_hash"}

SCORE_UNITS = ("mps",)  # units that end the name of a score
EVALUATED_END, WORLDS_END = "_evaluated", "_worlds"  # of columns of a family

ORIGIN = "origin"  # column of a store with a repertoire: the origin of a row's point
SOBOL_ROW, EVOLVED_ROW = "sobol", "evolved"


RENAMED = {"gain_names": "parameter_names", "gains": "points()"}


def shard_name(number: int) -> str:
    """File name of a shard."""
    return f"part-{number:05d}.parquet"


def evaluated_name(family: str) -> str:
    """Column of flags: was a point run in the worlds of a family?"""
    return f"{family}{EVALUATED_END}"


def family_names(family: str, score: str) -> tuple[str, str]:
    """Columns of a score's mean and spread over the worlds of a family.

    A unit stays last: robust_m5_sum_mean_mps.
    """
    stem, _, unit = score.rpartition("_")
    if unit not in SCORE_UNITS:
        return f"{family}_{score}_mean", f"{family}_{score}_sd"
    return f"{family}_{stem}_mean_{unit}", f"{family}_{stem}_sd_{unit}"


def outcome_name(family: str, column: str) -> str:
    """Column of what each world of a family gave."""
    return f"{family}_{column}{WORLDS_END}"


def arrow_schema(
    simulator: Simulator,
    families: Mapping[str, int] | None = None,
    outcomes: Sequence[str] = (),
    origin: bool = False,
) -> pa.Schema:
    """The schema of a shard of families with so many worlds, each of which keeps `outcomes`.

    With `origin`, rows name the origin of their points.
    """
    fields = [("row", pa.int64())]
    fields += [(parameter.name, pa.float64()) for parameter in simulator.parameters]
    for name in simulator.columns.names or ():
        kind = pa.from_numpy_dtype(simulator.columns[name])
        fields.append((name, pa.string() if name in simulator.words else kind))
    for family, worlds in (families or {}).items():
        fields.append((evaluated_name(family), pa.bool_()))
        for score in simulator.scores:
            fields += [(name, pa.float64()) for name in family_names(family, score)]
        each = pa.list_(pa.from_numpy_dtype(simulator.outcome_type), worlds)
        fields += [(outcome_name(family, name), each) for name in outcomes]
    if origin:
        fields.append((ORIGIN, pa.string()))
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in fields])


def columns_of(schema: pa.Schema) -> list[str]:
    """``name: type`` of every column, as a specification lists them."""
    return [f"{field.name}: {_type_name(field.type)}" for field in schema]


def _type_name(kind: pa.DataType) -> str:
    """Without a colon, which separates it from the name."""
    if not pa.types.is_fixed_size_list(kind):
        return str(kind)
    return f"{kind.value_type}[{kind.list_size}]"


def shard_table(
    schema: pa.Schema,
    simulator: Simulator,
    first_row: int,
    points: NDArray[np.float64],
    rows: NDArray[np.void],
    families: Mapping[str, NDArray[np.generic]],
    origin: str = SOBOL_ROW,
) -> pa.Table:
    """The table of a shard.

    Args:
        schema: its columns.
        simulator: that ran the points.
        first_row: number of its first row in the store.
        points: [n, p].
        rows: of the base setting, [n].
        families: columns of all families by name, [n] each, or [n, w] of outcomes.
        origin: where the points are from: `SOBOL_ROW` or `EVOLVED_ROW`.
    """
    columns: dict[str, NDArray[np.generic]] = {
        "row": np.arange(first_row, first_row + len(points)),
        ORIGIN: np.full(len(points), origin),
        **{
            each.name: values
            for each, values in zip(simulator.parameters, points.T, strict=True)
        },
        **{name: rows[name] for name in simulator.columns.names or ()},
        **{
            name: np.array(words)[rows[name]] for name, words in simulator.words.items()
        },
        **families,
    }
    arrays = [
        _array(np.ascontiguousarray(columns[each.name]), each.type) for each in schema
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _array(values: NDArray[np.generic], kind: pa.DataType) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values, kind)
    return pa.FixedSizeListArray.from_arrays(
        pa.array(values.ravel(), kind.value_type), type=kind
    )


@dataclass(frozen=True)
class Manifest:
    """Content of manifest.json.

    Attributes:
        specification: of the store, as JSON values.
        rows: of the whole store.
        hashes: SHA-256 by file name, in the order of the rows.
    """

    specification: dict[str, Any]
    rows: int
    hashes: dict[str, str]

    def write(self, folder: Path) -> None:
        """Commit it to a folder."""
        document = {
            "format": FORMAT,
            "specification_hash": document_hash(self.specification),
            "rows": self.rows,
            "shards": [
                {"file": name, "sha256": value} for name, value in self.hashes.items()
            ],
            "specification": self.specification,
        }
        commit_json(folder / MANIFEST_NAME, document)

    @staticmethod
    def read(folder: Path) -> "Manifest":
        """The manifest of a folder.

        Raises:
            InputError: there is none (the store is not finished), or it is damaged.
        """
        path = folder / MANIFEST_NAME
        allowed = (
            "a finished store, which has an undamaged manifest: run precompute.py again"
        )
        document = json_document("store", path, allowed)
        with reading("store", path, allowed):
            if document["format"] != FORMAT:
                raise ValueError(f"of format {document['format']!r}, not {FORMAT}")
            specification, rows = document["specification"], document["rows"]
            if document_hash(specification) != document["specification_hash"]:
                raise ValueError("its specification has another hash")
            hashes = {shard["file"]: shard["sha256"] for shard in document["shards"]}
            names = [shard_name(number) for number in range(len(hashes))]
            if not hashes or list(hashes) != names:
                first = shard_name(0)
                raise ValueError(
                    f"its shards are not {first} and so on, in the same folder"
                )
            if (
                not all(type(value) is str for value in hashes.values())
                or type(rows) is not int
            ):
                raise ValueError("rows or hashes that are none")
        return Manifest(specification, rows, hashes)


@dataclass(frozen=True)
class Store:
    """Scores of many points; rows are in the order of the points.

    Attributes:
        path: what was opened.
        files: its Parquet files.
        footers: of each file: shard, rows, code, engine, architecture, precision.
        columns: names of all columns.
        specification: of the store, as in specification.json.
        ROW: name of the column of the rows' numbers.
    """

    ROW: ClassVar[str] = "row"

    path: Path
    files: tuple[Path, ...]
    footers: tuple[dict[str, Any], ...]
    columns: tuple[str, ...]
    specification: dict[str, Any]

    def __len__(self) -> int:
        """Rows."""
        return sum(footer["rows"] for footer in self.footers)

    @checks.checked(columns=checks.optional(checks.each(checks.text)))
    def table(self, columns: Iterable[str] | None = None) -> pa.Table:
        """The rows as an Arrow table, which has `to_pandas()`.

        Args:
            columns: their names, in the order that the table is to have; None: all.
        """
        return pa.concat_tables(self.tables(columns))

    @checks.checked(columns=checks.optional(checks.each(checks.text)))
    def tables(self, columns: Iterable[str] | None = None) -> Iterator[pa.Table]:
        """The same, file by file, for a store that is larger than memory.

        Args:
            columns: as for `table`.
        """
        names = list(self.columns if columns is None else columns)
        for name in names:
            if name not in self.columns:
                raise InputError("column", name, f"one of {listed(self.columns, name)}")
        return (read_columns(file, names) for file in self.files)

    def numpy(self, columns: Iterable[str] | None = None) -> NDArray[np.void]:
        """The rows as a structured array, [n]; words are NumPy strings, outcomes [w] each.

        Args:
            columns: as for `table`.
        """
        table = self.table(columns)
        arrays = {}
        for name, kind in zip(table.column_names, table.schema.types, strict=True):
            column = table[name].combine_chunks()
            if pa.types.is_fixed_size_list(kind):
                arrays[name] = plain(column.flatten()).reshape(
                    len(table), kind.list_size
                )
            else:
                values = plain(column)
                arrays[name] = (
                    values.astype(np.str_) if values.dtype == object else values
                )
        kinds = [
            (name, values.dtype, values.shape[1:]) for name, values in arrays.items()
        ]
        rows = np.empty(len(table), kinds)
        for name, values in arrays.items():
            rows[name] = values
        return rows

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, [p]; of the walker: gains, and low-level gains after them."""
        return tuple(self.bounds)

    @property
    def bounds(self) -> dict[str, dict[str, Any]]:
        """Of each parameter "low" and "high", and its "distribution" where it is not a float's."""
        return dict(self.specification[PARAMETERS_KEY])

    @property
    def families(self) -> tuple[str, ...]:
        """Names of the families of settings: "robust" first."""
        robust = () if self.specification.get("robust") is None else ("robust",)
        return (*robust, *self.specification.get("families", {}))

    @checks.checked(family=checks.text)
    def settings_of(self, family: str) -> dict[str, Any]:
        """What the specification has of a family: its horizon, the worlds drawn and so on.

        Args:
            family: one of `families`.

        Raises:
            InputError: not one of `families`.
        """
        checks.word(*self.families)("family", family)
        known = (
            self.specification if family == "robust" else self.specification["families"]
        )
        return dict(known[family])

    @checks.checked(family=checks.text, column=checks.text)
    def outcomes(self, family: str, column: str) -> NDArray[np.floating[Any]]:
        """What each row gave in each world of a family, [n, w].

        NaN where it was not run, or where the run failed; how far a failed run came is
        zero.

        Args:
            family: one of `families`.
            column: one of `kept`; how far a run came is always among them.

        Raises:
            InputError: no such column; stores of versions before 0.3.0 have none.
        """
        return self.all_outcomes(column, (family,))[family]

    @checks.checked(family=checks.text)
    def kept(self, family: str) -> tuple[str, ...]:
        """The columns that each world of a family keeps; the first is how far a run came.

        Args:
            family: one of `families`.
        """
        checks.word(*self.families)("family", family)
        start = self.columns.index(evaluated_name(family)) + 1
        own = takewhile(
            lambda name: not name.endswith(EVALUATED_END), self.columns[start:]
        )
        return tuple(
            name.removeprefix(f"{family}_").removesuffix(WORLDS_END)
            for name in own
            if name.endswith(WORLDS_END)
        )

    @checks.checked(column=checks.text, families=checks.each(checks.text))
    def all_outcomes(
        self, column: str, families: Sequence[str]
    ) -> dict[str, NDArray[np.floating[Any]]]:
        """`outcomes` of several families, by name, from one look at the files.

        Args:
            column: one of `kept` of all these families.
            families: some of `families`.
        """
        names = {
            family: (outcome_name(family, column), evaluated_name(family))
            for family in families
        }
        rows = self.numpy(name for both in names.values() for name in both)
        return {
            family: np.where(
                rows[ran][:, None], rows[name], rows[name].dtype.type(np.nan)
            )
            for family, (name, ran) in names.items()
        }

    @property
    def simulator(self) -> str:
        """The name of the simulator; "walker": this project's."""
        return str(self.specification.get(SIMULATOR_KEY, WALKER))

    def points(self) -> NDArray[np.float64]:
        """The points, [n, p], in the order of `parameter_names`."""
        table = self.table(self.parameter_names)
        columns = [plain(table[name].combine_chunks()) for name in self.parameter_names]
        return np.column_stack(columns)

    def __getattr__(self, name: str) -> Any:
        """Names of 0.4.0, when all stores were the walker's."""
        if name in RENAMED:
            said = f"Store.{name} is called Store.{RENAMED[name]} now"
        else:
            said = f"'Store' object has no attribute {name!r}"
        raise AttributeError(said)

    def require_bounds(self) -> None:
        """Refuse a store whose points were drawn from other bounds than those of this version.

        A simulator of somebody else's has the bounds that its store names: no code of
        it is run.

        Raises:
            InputError: naming the parameter.
        """
        if self.simulator not in SIMULATORS:
            return
        stored = self.bounds
        parameters = known_simulator(self.specification).parameters_of(tuple(stored))
        current = {
            each.name: {"low": each.low, "high": each.high} for each in parameters
        }
        for name in dict.fromkeys([*current, *stored]):
            if stored.get(name) != current.get(name):
                allowed = f"{current.get(name)}, the bounds of this version; compute a new store"
                raise InputError(
                    f"store.{PARAMETERS_KEY}.{name}", stored.get(name), allowed
                )


@checks.checked(path=checks.path, verify=checks.flag, unfinished=checks.flag)
def open_store(
    path: str | Path, verify: bool = False, unfinished: bool = False
) -> Store:
    """Open a store's folder, a single shard, or a merged file.

    Args:
        path: the folder or the file.
        verify: also compare every file with its SHA-256 in the manifest beside it.
            Whenever columns are read, pages are compared with their checksums; a merged
            file, or a shard out of its folder, has only these.
        unfinished: of a folder that is still being filled, take the shards that are
            there.

    Raises:
        InputError: missing, unfinished, truncated, damaged, or not a store.
    """
    path = Path(path)
    manifest: Manifest | None = None
    files: tuple[Path, ...] = (path,)
    if not is_there(path):
        allowed = "a store, which `precompute` makes (No such file or directory)"
        raise InputError("store", str(path), allowed)
    if is_folder(path):
        shards = tuple(sorted(path.glob(SHARD_PATTERN))) if unfinished else ()
        if unfinished and not (path / MANIFEST_NAME).exists():  # which is written last
            if not shards:
                allowed = "a store of which `precompute` has finished a shard"
                raise InputError("store", str(path), allowed)
            files = shards
        else:
            manifest = Manifest.read(path)
            files = tuple(path / name for name in manifest.hashes)
    footers = tuple(map(_checked_footer, files))
    if manifest is not None:
        expected = document_hash(manifest.specification)
        for number, (file, footer) in enumerate(zip(files, footers, strict=True)):
            if (footer["specification_hash"], footer["shard"]) != (expected, number):
                raise InputError("store", str(file), f"shard {number} of this store")
        rows = sum(footer["rows"] for footer in footers)
        if rows != manifest.rows:
            raise InputError(
                "store", f"{rows} rows", f"{manifest.rows} rows, as the manifest says"
            )
    elif len({footer["specification_hash"] for footer in footers}) > 1:
        raise InputError("store", str(path), "a folder of shards of one store")
    specification = footers[0]["specification"]
    columns = tuple(column.rpartition(":")[0] for column in specification["columns"])
    if verify:
        for file in files:
            _verify(file)
    return Store(path, files, footers, columns, specification)


@checks.checked(source=checks.path, target=checks.path)
def merge(source: str | Path, target: str | Path) -> Store:
    """Write a store into one file, whole or not at all, and open it.

    Args:
        source: folder of a finished store.
        target: path of the file.
    """
    store, target = open_store(source, verify=True), Path(target)
    footer = {}
    # a value that all footers share, or the list of all values
    for key in store.footers[0]:
        values = [each[key] for each in store.footers]
        footer[key] = (
            values[0] if all(value == values[0] for value in values) else values
        )
    write_table(target, store.table(), footer | {"rows": len(store)})
    return open_store(target)


def _verify(file: Path) -> None:
    try:
        expected = Manifest.read(file.parent).hashes.get(file.name)
    except InputError:
        expected = None
    if expected is None:
        read_columns(file)
    elif file_hash(file) != expected:
        raise InputError(
            "store", str(file), f"a file of SHA-256 {expected}; compute it again"
        )


def _checked_footer(file: Path) -> dict[str, Any]:
    """The footer of a file that fits its specification."""
    footer, schema = read_footer(file)
    specification = footer["specification"]
    check_specification(specification, str(file))
    if document_hash(specification) != footer["specification_hash"]:
        raise InputError(
            "store", str(file), "a footer whose specification has its hash"
        )
    if columns_of(schema) != specification["columns"]:
        raise InputError(
            "store", str(file), "a file with the columns of its specification"
        )
    return footer


def read_footer(path: Path) -> tuple[dict[str, Any], pa.Schema]:
    """Footer and columns of a shard or a merged file.

    Raises:
        InputError: missing, truncated, not Parquet, or not of this project.
    """
    footer, schema, rows = read_about(path)
    if footer is None or not footer.keys() >= FOOTER_NEEDS:
        raise InputError(
            "store", str(path), "a file whose footer has a store's specification"
        )
    if footer["format"] != FORMAT:
        raise InputError(
            "store", str(path), f"format {FORMAT}, not {footer['format']!r}"
        )
    if footer["rows"] != rows:
        raise InputError(
            "store", str(path), f"a file of {footer['rows']!r} rows, not {rows}"
        )
    footer["rows"] = rows  # a whole number, which 1.0 or true are not
    return footer, schema


def check_specification(specification: Any, where: str) -> None:
    """Refuse a specification, a value of JSON, without the keys that readers of stores need.

    Raises:
        InputError: naming the file `where` it is, and the key.
    """
    if not isinstance(specification, dict):
        raise InputError(where, specification, "a specification, which is an object")
    table = Table(specification, where)
    columns = [column.rpartition(":")[0] for column in table.texts("columns")]
    parameters = table.table(PARAMETERS_KEY)
    names = list(parameters.unread)
    if not names or not set(names) <= set(columns):
        allowed = "names of columns, one at least"
        raise InputError(f"{where}.{PARAMETERS_KEY}", names, allowed)
    for name in names:
        ends = parameters.table(name)
        ends.number("low", high=ends.number("high"))
    table.table("simulation").number("duration_s")
    table.text(SIMULATOR_KEY, WALKER)
    families = table.table("families")
    for name in families.unread:
        families.table(name)
    if specification.get("robust") is not None:
        table.table("robust")
