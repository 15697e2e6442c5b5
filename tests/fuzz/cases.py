"""A case: a folder of sound files of which one is damaged, and the words of a command.

`FORMATS` are the formats that commands read: their files, the commands that read them, and how the
files are damaged. Case n of a seed is the same on every machine, and depends on no other.
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
from tests.fuzz.damage import (
    OPTIONS,
    as_json,
    as_toml,
    chance,
    damaged_bytes,
    damaged_columns,
    damaged_database,
    damaged_document,
    damaged_footer,
    damaged_text,
    pick,
)
from tests.fuzz.world import (
    COMMANDS,
    ONE,
    PACKERS,
    PRECOMPUTE,
    STILL,
    STUDY,
    UNPACKERS,
    Words,
)

Damage = Callable[[Generator, Path], None]

# As those of the world, but into new folders: another configuration than there is not refused.
NEW = ("--out", "new", *ONE)
NEW_STUDY = ("study", "--out", "new", "--storage", "sqlite:///new.db", "--config")
WALK_SOFT = ("walk", "--config", "mujoco-rough8-soft.toml", *STILL)
COMPARE_NEW = ("compare", "--config", "toy.toml", "--no-artifacts", *NEW)
PRECOMPUTE_NEW = ("precompute", "--config", "grid.toml", *NEW)
PRECOMPUTE_WORLDS = ("precompute", "--config", "store-worlds.toml", "--samples", "8", *NEW)


def text_of(rng: Generator, path: Path) -> None:
    """A text, or its bytes."""
    data = path.read_bytes()
    if chance(rng, 0.3):
        path.write_bytes(damaged_bytes(rng, data))
    else:
        path.write_bytes(damaged_text(rng, data.decode()))


def packed(rng: Generator, path: Path) -> None:
    """A packed text: what is in it, or its bytes."""
    pack, unpack = PACKERS.get(path.suffix, bytes), UNPACKERS.get(path.suffix, bytes)
    data = path.read_bytes()
    if chance(rng, 0.4):
        path.write_bytes(damaged_bytes(rng, data))
    else:
        path.write_bytes(pack(damaged_text(rng, unpack(data).decode())))


def json_of(rng: Generator, path: Path) -> None:
    """A JSON document, or its text."""
    if chance(rng, 0.25):
        text_of(rng, path)
    else:
        path.write_bytes(as_json(damaged_document(rng, json.loads(path.read_text()))))


def toml_of(rng: Generator, path: Path) -> None:
    """A TOML document, or its text."""
    if chance(rng, 0.25):
        text_of(rng, path)
    else:
        path.write_bytes(as_toml(damaged_document(rng, tomllib.loads(path.read_text()))))


def bytes_of(rng: Generator, path: Path) -> None:
    """Any file."""
    path.write_bytes(damaged_bytes(rng, path.read_bytes()))


def either(*kinds: Damage) -> Damage:
    """One of some kinds of damage."""
    return lambda rng, path: pick(rng, kinds)(rng, path)


def misplaced(rng: Generator, path: Path) -> None:
    """Something else in the file's place: nothing, a folder, another file, a link, a pipe."""
    others = sorted(each for each in path.parent.iterdir() if each.is_file() and each != path)
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
    """A kind of input.

    Attributes:
        name: of it.
        share: of all cases, beside those of the others.
        files: one of which is damaged.
        readers: commands, one of which is run; names of `COMMANDS`, or words.
        damage: to the file.
    """

    name: str
    share: int
    files: tuple[str, ...]
    readers: tuple[str | Words, ...]
    damage: Damage

    def prepare(self, rng: Generator, folder: Path) -> Words:
        """Damage a file of the folder; the words of the command to be run."""
        name = pick(rng, self.files)
        reader = pick(rng, self.readers)
        words = COMMANDS[reader] if isinstance(reader, str) else reader
        path = folder / name
        if path.parent.name == "arms" and chance(rng, 0.5):  # as of an unfinished comparison
            (path.parents[1] / "trials.parquet").unlink()
        (misplaced if chance(rng, 0.04) else self.damage)(rng, path)
        return tuple(word.replace("{file}", name) for word in words)


@dataclass(frozen=True)
class Arguments:
    """What is given to commands: `Format` without a file."""

    name: str
    share: int

    def prepare(self, rng: Generator, folder: Path) -> Words:
        """The words of a command with some replaced, added, dropped or doubled."""
        words = list(COMMANDS[pick(rng, list(COMMANDS))])
        options = options_of(words[0])
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
def options_of(command: str) -> tuple[str, ...]:
    """Options of a command, and one that it has not."""
    options = [word for action in parser_of(command)._actions for word in action.option_strings]
    return (*(word for word in options if word.startswith("--")), "--nothing")


STORE = ("draw-store", "explore", *["walk of a row"] * 3, "study", "compare", COMPARE_NEW)
TERRAIN = ("walk", "--config", "{file}.toml", *STILL)
DATABASE = ("walk of a live trial", "study", (*STUDY, "--trials", "3"),
            ("dashboard", "--storage", "sqlite:///live.db", "--port", "0"),
            (*COMPARE_NEW, "--storage", "sqlite:///live.db"))  # fmt: skip
EXPORTED = ("compare", "dashboard", "walk of an exported trial")

FORMATS: tuple[Format | Arguments, ...] = (
    Arguments("arguments", 20),
    Format(
        "experiment, TOML", 16, ("toy.toml",),
        ("walk", "compare", COMPARE_NEW, (*NEW_STUDY, "toy.toml", "--arm", "dog"),
         (*NEW_STUDY, "toy.toml", "--arm", "random")),
        toml_of,
    ),
    Format("experiment on MuJoCo, TOML", 4, ("mujoco-rough8.toml",), (WALK_SOFT,), toml_of),
    Format("optimum's experiment, TOML", 3, ("level.toml",), ("optimum",), toml_of),
    Format("store, TOML", 8, ("grid.toml",), ("precompute", PRECOMPUTE_NEW, PRECOMPUTE_NEW),
           toml_of),
    Format("store of worlds, TOML", 2, ("store-worlds.toml",), (PRECOMPUTE_WORLDS,), toml_of),
    Format("gains, JSON", 10, ("gains.json", "best/dog-run-000-best.json"),
           (("walk", "--gains", "{file}", *STILL),), json_of),
    Format("terrain table", 10, ("hill.csv", "hill.csv.gz", "hill.csv.bz2", "hill.csv.xz"),
           (TERRAIN,), packed),
    Format("store's manifest", 6, ("store/manifest.json",), STORE, json_of),
    Format("store's shard, bytes", 6, ("store/part-00000.parquet",), STORE, bytes_of),
    Format("store's footer", 6, ("store/part-00000.parquet",), STORE, damaged_footer),
    Format("store's columns", 5, ("store/part-00000.parquet",), STORE, damaged_columns),
    Format(
        "store that goes on", 5,
        ("grid/specification.json", "grid/manifest.json", "grid/part-00001.parquet"),
        (PRECOMPUTE, PRECOMPUTE, (*PRECOMPUTE, "--fresh")),
        lambda rng, path: (json_of if path.suffix == ".json" else
                           either(bytes_of, damaged_footer, damaged_columns))(rng, path),
    ),
    Format("experiment.json", 6, ("compared/experiment.json",),
           ("report", "report with strips", "compare", "walk of a trial",
            "explore of a comparison"), json_of),
    Format("run.json", 3, ("compared/run.json",), ("report", "report", "compare"), json_of),
    Format("trials.parquet", 6, ("compared/trials.parquet",),
           ("report", "walk of a trial", "walk of a trial", "explore of a comparison"),
           either(bytes_of, damaged_columns)),
    Format("an arm's trials", 6, ("compared/arms/dog.parquet", "compared/arms/random.parquet"),
           ("report", "compare", "compare"),
           either(bytes_of, damaged_columns, damaged_columns, damaged_footer)),
    Format(
        "optimum's folder", 3,
        ("optimum/search.json", "optimum/evaluations.parquet", "optimum/dog/experiment.json",
         "optimum/dog/arms/dog.parquet"),
        ("optimum",),
        lambda rng, path: (json_of if path.suffix == ".json" else
                           either(bytes_of, damaged_columns, damaged_footer))(rng, path),
    ),
    Format("optimum.json", 2, ("optimum/optimum.json",), ("report of two",), json_of),
    Format("live studies, SQLite", 7, ("live.db",), DATABASE,
           either(bytes_of, damaged_database, damaged_database, damaged_database)),
    Format("a comparison's studies, SQLite", 3, ("compared/studies.db",), EXPORTED,
           either(bytes_of, damaged_database, damaged_database, damaged_database)),
)  # fmt: skip

SHARES = np.array([each.share for each in FORMATS], dtype=float)
NAMES = tuple(each.name for each in FORMATS)
HERE = "here"  # of a case, where its command is run: a ".." leads no farther than the case


@dataclass(frozen=True)
class Case:
    """What is run.

    Attributes:
        number: of the case.
        name: of its format.
        words: of the command.
        folder: in which it is run.
    """

    number: int
    name: str
    words: Words
    folder: Path


def make_case(seed: int, number: int, world: Path, place: Path) -> Case:
    """Make the case's folder, in place of one that is there.

    Args:
        seed: of all cases.
        number: from 0.
        world: folder of sound files.
        place: a folder for this case alone.
    """
    shutil.rmtree(place, ignore_errors=True)
    folder = Path(shutil.copytree(world, place / HERE))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    chosen = FORMATS[int(rng.choice(len(FORMATS), p=SHARES / SHARES.sum()))]
    return Case(number, chosen.name, chosen.prepare(rng, folder), folder)
