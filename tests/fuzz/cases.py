"""A case: a folder of sound files of which one is damaged, and the words of a command.

Case n of a seed is the same on every machine, and depends on no other.
"""

import json
import os
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.random import Generator

from study.options import parser_of
from tests.cases import asset
from tests.fuzz import damage
from tests.fuzz.damage import OPTIONS, chance, pick
from tests.fuzz.world import COMMANDS, PACKERS, UNPACKERS, Words

Damage = Callable[[Generator, Path], None]


def in_bytes(rng, path):
    path.write_bytes(damage.damaged_bytes(rng, path.read_bytes()))


def in_text(rng, path):
    """In a text, which may be packed, or in its bytes."""
    if chance(rng, 0.35):
        return in_bytes(rng, path)
    pack, unpack = PACKERS.get(path.suffix, bytes), UNPACKERS.get(path.suffix, bytes)
    text = unpack(path.read_bytes()).decode()
    path.write_bytes(pack(damage.damaged_text(rng, text)))


def in_cells(rng, path):
    """In a column of a CSV."""
    path.write_bytes(damage.damaged_cells(rng, path.read_text()))


def in_document(read, write):
    """In a document, or in its text."""

    def change(rng, path):
        if chance(rng, 0.25):
            in_text(rng, path)
        else:
            path.write_bytes(
                write(damage.damaged_document(rng, read(path.read_text())))
            )

    return change


def either(*kinds):
    """One of some kinds of damage."""
    return lambda rng, path: KINDS[pick(rng, kinds) if len(kinds) > 1 else kinds[0]](
        rng, path
    )


def in_folder_file(rng, path):
    """In a file of a folder that a command goes on with."""
    kinds = ("json",) if path.suffix == ".json" else ("bytes", "columns", "footer")
    either(*kinds)(rng, path)


KINDS = {
    "bytes": in_bytes,
    "text": in_text,
    "json": in_document(json.loads, damage.as_json),
    "toml": in_document(tomllib.loads, damage.as_toml),
    "columns": damage.damaged_columns,
    "footer": damage.damaged_footer,
    "database": damage.damaged_database,
    "file of a folder": in_folder_file,
    "cells": in_cells,
}


def misplaced(rng, path):
    """Something else in the file's place: nothing, a folder, another file, a link, a pipe."""
    others = sorted(
        each for each in path.parent.iterdir() if each.is_file() and each != path
    )
    path.unlink()
    kind = int(rng.integers(6))
    if kind == 1:
        path.mkdir()
    elif kind == 2 and others:
        shutil.copy(pick(rng, others), path)
    elif kind == 3:
        path.symlink_to(pick(rng, (path.name, "nothing", ".", "/dev/zero")))
    elif kind == 4:
        os.mkfifo(path)
    elif kind == 5:
        path.touch()


@dataclass(frozen=True)
class Format:
    """A kind of input: files of which one is damaged, and the commands that read it."""

    name: str
    share: int  # of all cases, beside those of the others
    files: tuple[str, ...]  # none where the words of the command are damaged
    readers: tuple[Words, ...]
    damage: Damage

    def prepare(self, rng, folder):
        """Damage a file of the folder; the words of the command to be run."""
        words = pick(rng, self.readers)
        if not self.files:
            return damaged_words(rng, words)
        path = folder / (name := pick(rng, self.files))
        # as of an unfinished comparison
        if path.parent.name == "arms" and chance(rng, 0.5):
            (path.parents[1] / "trials.parquet").unlink()
        (misplaced if chance(rng, 0.04) else self.damage)(rng, path)
        return tuple(word.replace("{file}", name) for word in words)


def damaged_words(rng, sound):
    """The words of a command with some replaced, added, dropped or doubled."""
    words, options = list(sound), options_of(sound[0])
    for _ in range(1 + int(rng.exponential(0.7))):
        place = 1 + int(rng.integers(len(words)))
        kind = int(rng.integers(10))
        if kind < 4 and place < len(words):
            words[place] = pick(rng, OPTIONS)
        elif kind < 8:
            words[place:place] = [pick(rng, options), pick(rng, OPTIONS)]
        elif kind == 8:
            del words[place : place + 1]
        else:
            words.insert(place, pick(rng, (*options, *OPTIONS)))
    if chance(rng, 0.01):
        words[:1] = [] if chance(rng, 0.2) else [pick(rng, OPTIONS)]
    return tuple(words)


@cache
def options_of(command):
    """Options of a command, and one that it has not."""
    options = [
        word for action in parser_of(command)._actions for word in action.option_strings
    ]
    return (*(word for word in options if word.startswith("--")), "--nothing")


def words_of(reader):
    """Of a name in `COMMANDS`, or as they stand."""
    return COMMANDS.get(reader) or tuple(reader.split())


FORMATS = tuple(
    Format(
        name,
        row["share"],
        tuple(row["files"]),
        tuple(map(words_of, row.get("readers", COMMANDS))),
        either(*row["damage"]),
    )
    for name, row in asset("fuzz/formats.toml").items()
)
SHARES = np.array([each.share for each in FORMATS], dtype=float)
NAMES = tuple(each.name for each in FORMATS)
# of a case, where its command is run: a ".." leads no farther than the case
HERE = "here"


@dataclass(frozen=True)
class Case:
    """A numbered case: its format's name, the words of its command, and the folder to run it in."""

    number: int
    name: str
    words: Words
    folder: Path


def make_case(seed, number, world, place):
    """Make the case's folder, of the sound files of `world`, in `place`, which is for it alone."""
    shutil.rmtree(place, ignore_errors=True)
    folder = Path(shutil.copytree(world, place / HERE))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    chosen = FORMATS[int(rng.choice(len(FORMATS), p=SHARES / SHARES.sum()))]
    return Case(number, chosen.name, chosen.prepare(rng, folder), folder)
