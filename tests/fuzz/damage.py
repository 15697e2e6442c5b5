"""Damage to bytes, texts, documents, Parquet files and databases, decided by `rng` alone."""

import hashlib
import json
import math
import re
import sqlite3
from contextlib import closing, suppress
from copy import deepcopy
from functools import partial

import pyarrow as pa
import pyarrow.parquet as pq

from storage.tables import DIGEST_KEY, FOOTER_KEY, document_hash, table_digest
from tests.cases import ASSETS

HUGE = 10**400


def short(written):
    """What an object of damage.json stands for, if it is a value too long to be written there."""
    if "power" in written:
        return 10 ** written["power"]
    return written["of"] * written["times"] if "times" in written else written


KNOWN = json.loads(
    (ASSETS / "damage.json").read_text(encoding="utf-8"), object_hook=short
)
# Values for JSON, TOML, Parquet and SQLite; words for text files, for a word or between
# two; cells of a column as a stranger's program writes it, kind by kind.
VALUES = tuple(KNOWN["values"])
WORDS = tuple(KNOWN["words"])
# Values for options, some of them names of files and folders of the world, or, with
# half a character, of no UTF-8. None is an absolute path that can be written: the tests
# may run as root.
OPTIONS = tuple(KNOWN["options"])


PIECES = re.compile(r"[\w.+-]+|\s+|[^\w\s]")
DEEP = 200  # lists in each other


def pick(rng, values):
    return values[int(rng.integers(len(values)))]


def chance(rng, of):
    return bool(rng.random() < of)


def damaged_bytes(rng, data):
    """Bits flipped, a part cut out, doubled, overwritten or put in; or cut short, or empty."""
    parts = bytearray(data)
    for _ in range(1 + int(rng.integers(3))):
        place = int(rng.random() * len(parts))
        if chance(rng, 0.5):  # formats say at their end what they are
            place = max(0, len(parts) - 1 - int(rng.exponential(200)))
        end = place + 1 + int(rng.exponential(12))
        kind = int(rng.integers(7))
        if kind == 0 and parts:
            parts[place] ^= 1 << int(rng.integers(8))
        elif kind == 6 and chance(rng, 0.3):
            del parts[place:]
        elif kind < 6:
            old, new = bytes(parts[place:end]), rng.bytes(end - place)
            even = bytes([pick(rng, (0, 255, 127, 128))]) * (end - place)
            parts[place:end] = (old, b"", old * 2, even, new + old, new)[kind]
    return b"" if chance(rng, 0.01) else bytes(parts)


def damaged_text(rng, text):
    """Words replaced, put in, dropped or moved, and lines; now and then in another encoding."""
    pieces = PIECES.findall(text)
    for _ in range(1 + int(rng.integers(3))):
        place = int(rng.integers(len(pieces) + 1)) if pieces else 0
        kind = int(rng.integers(5))
        if kind == 0 and place < len(pieces):
            pieces[place] = pick(rng, WORDS)
        elif kind == 1:
            pieces.insert(place, pick(rng, WORDS))
        elif kind == 2:
            del pieces[place : place + 1 + int(rng.exponential(2))]
        elif kind == 3 and pieces:
            pieces.insert(place, pick(rng, pieces))
        else:
            lines = "".join(pieces).splitlines(keepends=True) or [""]
            pieces = [*lines, pick(rng, lines)] if chance(rng, 0.5) else lines[::-1]
    encoding = pick(rng, ("utf-8",) * 20 + ("utf-16", "utf-8-sig", "latin-1"))
    return "".join(pieces).encode(encoding, errors="replace")


def damaged_cells(rng, text):
    """A CSV with the cells of a column replaced by others of one kind; some, or all of them."""
    rows = [line.split(",") for line in text.splitlines()]
    place, kind = int(rng.integers(len(rows[0]))), pick(rng, KNOWN["cells"])
    share = pick(rng, (0.05, 0.5, 1.0))
    for row in rows[1:]:
        if place < len(row) and chance(rng, share):
            row[place] = pick(rng, kind)
    comma, end = pick(rng, ((",", "\n"),) * 4 + ((";", "\r\n"), ("\t", "\n")))
    return end.join([*map(comma.join, rows), ""]).encode(
        pick(rng, ("utf-8", "utf-8-sig"))
    )


def damaged_document(rng, document):
    """A value somewhere in it replaced, dropped, named otherwise, added, moved or nested deep."""
    document = json.loads(json.dumps(document))
    for _ in range(1 + int(rng.exponential(0.5))):
        places = places_in(document)
        if not places:
            return any_value(rng)
        node, key = pick(rng, places)
        kind = int(rng.integers(8))
        if kind == 0:
            del node[key]
        elif kind == 1 and isinstance(node, dict):
            node[f"{pick(rng, ('', 'x', 'é'))}{key}"] = node.pop(key)
        elif kind == 2 and isinstance(node, dict):
            node[pick(rng, ("a", "", "name", "seed", "format", "x" * 300))] = any_value(
                rng
            )
        elif kind == 3:
            other, its = pick(rng, places)
            if its in keys(other):
                node[key] = json.loads(json.dumps(other[its]))
        elif kind == 4 and chance(rng, 0.2):
            for _ in range(DEEP):
                node[key] = [node[key]]
        else:
            node[key] = nudged(rng, node[key])
    return document


def any_value(rng):
    """A copy of one of `VALUES`: later damage must not change these."""
    return deepcopy(pick(rng, VALUES))


def nudged(rng, value):
    """Another value: of the same kind and close, or any."""
    if chance(rng, 0.6) or isinstance(value, bool | None | list | dict):
        return any_value(rng)
    if isinstance(value, str):
        return pick(
            rng, (value + " ", value.upper(), value[1:], value + "\u0000", value * 50)
        )
    try:
        fractions = float(value), value / 3
    except OverflowError:  # a whole number above all floats
        fractions = math.inf, -math.inf
    return pick(
        rng, (-value, value + 1, value * 1000, fractions[0], str(value), fractions[1])
    )


def keys(node):
    if isinstance(node, dict):
        return list(node)
    return list(range(len(node))) if isinstance(node, list) else []


def places_in(document):
    """Every value in a document, as an object or list and a key of it."""
    own = [(document, key) for key in keys(document)]
    return [
        place for node, key in own for place in ((node, key), *places_in(node[key]))
    ]


def as_json(document):
    """As Python writes it: with NaN and infinity, and escapes of halves of characters."""
    return json.dumps(document, indent=1).encode()


def as_toml(document):
    """As TOML, tables within lines; values that TOML lacks are written as in JSON."""
    lines = pairs(document) if isinstance(document, dict) else [toml_value(document)]
    return "".join(f"{line}\n" for line in lines).encode(errors="replace")


def pairs(table):
    return [f"{json.dumps(key)} = {toml_value(value)}" for key, value in table.items()]


def toml_value(value):
    if isinstance(value, dict):
        return f"{{{', '.join(pairs(value))}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml_value, value))}]"
    is_json = not isinstance(value, float) or math.isfinite(value)
    return json.dumps(value) if is_json else str(value)


# All types by their names, and some that have none.
TYPES = (
    *map(pa.type_for_alias, KNOWN["types"]),
    pa.list_(pa.float64()),
    pa.dictionary(pa.int32(), pa.string()),
    pa.decimal128(20, 2),
    pa.decimal128(20, 0),
    pa.timestamp("ns", "UTC"),
)


def damaged_columns(rng, path):
    """Write the file again: a column dropped, renamed, doubled, of another type, with other values.

    Its footer stays; a digest in it is made to fit, so that readers check the values
    too.
    """
    table = pq.read_table(path, partitioning=None)
    footer = table.schema.metadata
    for _ in range(1 + int(rng.exponential(0.4))):
        table = other_table(rng, table.replace_schema_metadata(None))
    if footer and FOOTER_KEY in footer:
        document = json.loads(footer[FOOTER_KEY])
        if DIGEST_KEY in document and chance(rng, 0.8):
            with suppress(Exception):  # of types that have no digest
                document[DIGEST_KEY] = table_digest(table)
        table = table.replace_schema_metadata({FOOTER_KEY: json.dumps(document)})
    write(table, path)


write = partial(pq.write_table, compression="zstd", write_page_checksum=True)


def other_table(rng, table):
    """A table with one change."""
    rows, kind = len(table), int(rng.integers(9))
    if kind == 0 or not table.num_columns:
        return table.slice(int(rng.integers(rows + 1)), int(rng.integers(rows + 1)))
    place = int(rng.integers(table.num_columns))
    field, names = table.schema.field(place), list(table.column_names)
    if kind == 1:
        return table.remove_column(place)
    if kind == 2:
        names[place] = pick(
            rng, ("", "a", names[0], names[-1], "\n", f" {names[place]}")
        )
        return table.rename_columns(names)
    if kind == 3:
        return table.append_column(field, table.column(place))
    if kind == 4:
        return pa.concat_tables([table, table.slice(0, min(rows, 2))])
    if kind == 5:
        return table.take(pa.array(rng.permutation(rows)))
    values, other = table.column(place).to_pylist(), field.type
    if kind == 6:
        other = pick(rng, TYPES)
    else:
        for _ in range(pick(rng, (1, 1, 2, rows)) if rows else 0):
            values[int(rng.integers(rows))] = pick(rng, VALUES)
    return table.set_column(place, field.name, as_column(values, other))


def as_column(values, kind):
    """The values as this type; those that are none of it are left out."""
    kept = [None] * len(values)
    for place, value in enumerate(values):
        with suppress(pa.ArrowException, TypeError, ValueError, OverflowError):
            pa.array([value], kind)
            kept[place] = value
    return pa.array(kept, kind)


def damaged_footer(rng, path):
    """Write the file again with a damaged document in its footer, or none, or no JSON.

    Hashes in it are made to fit now and then, so that readers check the rest too.
    """
    table = pq.read_table(path, partitioning=None)
    document = damaged_document(rng, json.loads(table.schema.metadata[FOOTER_KEY]))
    if chance(rng, 0.5):
        sign(document)
    text = json.dumps(document).encode()
    metadata = pick(
        rng, ({FOOTER_KEY: text},) * 20 + (None, {FOOTER_KEY: b"\xff"}, {b"a": text})
    )
    write(table.replace_schema_metadata(metadata), path)
    manifest = path.with_name("manifest.json")
    if manifest.is_file() and chance(rng, 0.5):
        known = json.loads(manifest.read_text())
        for shard in known["shards"]:
            if shard["file"] == path.name:
                shard["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
        if isinstance(document, dict) and "specification" in document:
            known["specification"] = document["specification"]
            sign(known)
        manifest.write_text(json.dumps(known))


def sign(document):
    """Have the hash of a specification fit it, where there is one."""
    if isinstance(document, dict) and "specification" in document:
        document["specification_hash"] = document_hash(document["specification"])


def damaged_database(rng, path):
    """Values of cells replaced, rows dropped or doubled, a table dropped or renamed."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        for _ in range(1 + int(rng.exponential(0.5))):
            with suppress(sqlite3.Error):  # a constraint that stands in the way
                change_database(rng, connection)
        connection.commit()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def change_database(rng, connection):
    """One change."""
    where = "WHERE type = 'table' AND name NOT LIKE 'sqlite%' ORDER BY name"
    tables = connection.execute(f"SELECT name FROM sqlite_master {where}")
    name = pick(rng, [row[0] for row in tables])
    columns = [row[1] for row in connection.execute(f'PRAGMA table_info("{name}")')]
    column = pick(rng, columns)
    rows = connection.execute(
        f'SELECT rowid, "{column}" FROM "{name}" ORDER BY rowid'
    ).fetchall()
    kind = int(rng.integers(14))
    if kind == 0:
        connection.execute(f'DROP TABLE "{name}"')
    elif kind == 1:
        connection.execute(
            f'ALTER TABLE "{name}" RENAME COLUMN "{column}" TO "{column}_"'
        )
    elif not rows:
        return
    elif kind == 2:
        connection.execute(
            f'DELETE FROM "{name}" WHERE rowid = ?', (pick(rng, rows)[0],)
        )
    elif kind == 3:
        connection.execute(f'DELETE FROM "{name}"')
    elif kind == 4:
        others = ", ".join(f'"{each}"' for each in columns[1:])
        connection.execute(
            f'INSERT INTO "{name}" ({others}) SELECT {others} FROM "{name}"'
        )
    else:
        row, old = pick(rng, rows)
        value = in_cell(rng, old)
        every = "" if chance(rng, 0.15) else f" WHERE rowid = {row}"
        connection.execute(f'UPDATE "{name}" SET "{column}" = ?{every}', (value,))


def in_cell(rng, old):
    """A value for a cell; of JSON, where there was JSON."""
    if isinstance(old, str):
        with suppress(ValueError):
            document = json.loads(old)
            changed = (
                damaged_document(rng, document)
                if chance(rng, 0.7)
                else pick(rng, VALUES)
            )
            return json.dumps(changed) if chance(rng, 0.9) else json.dumps(changed)[:-1]
    value = pick(rng, VALUES)
    if isinstance(value, str):
        return value.encode() if chance(rng, 0.2) else value
    fits = not isinstance(value, int) or abs(value) < 2**63
    return (
        value if fits and isinstance(value, float | int | None) else json.dumps(value)
    )
