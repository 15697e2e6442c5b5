"""Damage to bytes, texts and documents; each returns a new one, and `rng` is all its luck."""

import json
import math
import re
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

from numpy.random import Generator

from tests.fuzz.hostile import VALUES, WORDS, chance, pick

PIECES = re.compile(r"[\w.+-]+|\s+|[^\w\s]")
DEEP = 200  # lists in each other


def damaged_bytes(rng: Generator, data: bytes) -> bytes:
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
        elif kind == 1:
            del parts[place:end]
        elif kind == 2:
            parts[place:place] = parts[place:end]
        elif kind == 3:
            parts[place:end] = bytes([pick(rng, (0, 255, 127, 128))]) * (end - place)
        elif kind == 4:
            parts[place:place] = rng.bytes(end - place)
        elif kind == 5:
            parts[place:end] = rng.bytes(end - place)
        elif chance(rng, 0.3):
            del parts[place:]
    return b"" if chance(rng, 0.01) else bytes(parts)


def damaged_text(rng: Generator, text: str) -> bytes:
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


def damaged_document(rng: Generator, document: Any) -> Any:
    """A value somewhere in it replaced, dropped, named otherwise, added, moved or nested deep."""
    document = json.loads(json.dumps(document))
    for _ in range(1 + int(rng.exponential(0.5))):
        places = [(document, key) for key in keys(document)]
        places += [(node, key) for node in nodes(document) for key in keys(node)]
        if not places:
            return any_value(rng)
        node, key = pick(rng, places)
        kind = int(rng.integers(8))
        if kind == 0:
            del node[key]
        elif kind == 1 and isinstance(node, dict):
            node[f"{pick(rng, ('', 'x', 'é'))}{key}"] = node.pop(key)
        elif kind == 2 and isinstance(node, dict):
            node[pick(rng, ("a", "", "name", "seed", "format", "x" * 300))] = any_value(rng)
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


def any_value(rng: Generator) -> Any:
    """One of `VALUES`, which what is done to it leaves as they are."""
    return deepcopy(pick(rng, VALUES))


def nudged(rng: Generator, value: Any) -> Any:
    """Another value: of the same kind and close, or any."""
    if chance(rng, 0.6) or isinstance(value, bool | None | list | dict):
        return any_value(rng)
    if isinstance(value, str):
        return pick(rng, (value + " ", value.upper(), value[1:], value + "\u0000", value * 50))
    try:
        fractions = float(value), value / 3
    except OverflowError:  # a whole number that no float is as large as
        fractions = math.inf, -math.inf
    return pick(rng, (-value, value + 1, value * 1000, fractions[0], str(value), fractions[1]))


def nodes(document: Any) -> Iterator[Any]:
    """All objects and lists below a document."""
    for key in keys(document):
        if isinstance(document[key], dict | list):
            yield document[key]
            yield from nodes(document[key])


def keys(node: Any) -> list[Any]:
    """Of an object, or places in a list."""
    if isinstance(node, dict):
        return list(node)
    return list(range(len(node))) if isinstance(node, list) else []


def as_json(document: Any) -> bytes:
    """As Python writes it: with NaN and infinity, and escapes of halves of characters."""
    return json.dumps(document, indent=1).encode()


def as_toml(document: Any) -> bytes:
    """As TOML, tables within lines; what TOML has no word for is left to be refused."""
    if not isinstance(document, dict):
        return toml_value(document).encode(errors="replace")
    lines = [f"{json.dumps(key)} = {toml_value(value)}\n" for key, value in document.items()]
    return "".join(lines).encode(errors="replace")


def toml_value(value: Any) -> str:
    """A value in a line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else f"{value}"
    return json.dumps(value)
