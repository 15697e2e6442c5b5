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
from typing import Any

import numpy as np
from numpy.random import Generator

from study.options import parser_of
from tests.fuzz import damage
from tests.fuzz.damage import OPTIONS, chance, pick
from tests.fuzz.world import COMMANDS, ONE, PACKERS, PRECOMPUTE, STILL, STUDY, UNPACKERS, Words

Damage = Callable[[Generator, Path], None]

# As those of the world, but into new folders: another configuration than there is not refused.
NEW = ("--out", "new", *ONE)
NEW_STUDY = ("study", "--out", "new", "--storage", "sqlite:///new.db", "--config", "toy.toml",
             "--arm")  # fmt: skip
WALK_SOFT = ("walk", "--config", "mujoco-rough8-soft.toml", *STILL)
COMPARE_NEW = ("compare", "--config", "toy.toml", *NEW)
PRECOMPUTE_NEW = ("precompute", "--config", "grid.toml", *NEW)
PRECOMPUTE_WORLDS = ("precompute", "--config", "store-worlds.toml", "--samples", "8", *NEW)


def in_bytes(rng: Generator, path: Path) -> None:
    path.write_bytes(damage.damaged_bytes(rng, path.read_bytes()))


def in_text(rng: Generator, path: Path) -> None:
    """In a text, which may be packed, or in its bytes."""
    if chance(rng, 0.35):
        return in_bytes(rng, path)
    pack, unpack = PACKERS.get(path.suffix, bytes), UNPACKERS.get(path.suffix, bytes)
    text = unpack(path.read_bytes()).decode()
    path.write_bytes(pack(damage.damaged_text(rng, text)))


def in_document(read: Callable[[str], Any], write: Callable[[Any], bytes]) -> Damage:
    """In a document, or in its text."""

    def change(rng: Generator, path: Path) -> None:
        if chance(rng, 0.25):
            in_text(rng, path)
        else:
            path.write_bytes(write(damage.damaged_document(rng, read(path.read_text()))))

    return change


def either(*kinds: Damage) -> Damage:
    return lambda rng, path: pick(rng, kinds)(rng, path)


in_json = in_document(json.loads, damage.as_json)
in_toml = in_document(tomllib.loads, damage.as_toml)
in_columns, in_footer = damage.damaged_columns, damage.damaged_footer
in_database = either(in_bytes, *[damage.damaged_database] * 3)


def in_folder_file(rng: Generator, path: Path) -> None:
    """In a file of a folder that a command goes on with."""
    (in_json if path.suffix == ".json" else either(in_bytes, in_columns, in_footer))(rng, path)


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
    """A kind of input: files of which one is damaged, and the commands that read it."""

    name: str
    share: int  # of all cases, beside those of the others
    files: tuple[str, ...]  # none where the words of the command are damaged
    readers: tuple[str | Words, ...]  # names of `COMMANDS`, or words
    damage: Damage = in_bytes

    def prepare(self, rng: Generator, folder: Path) -> Words:
        """Damage a file of the folder; the words of the command to be run."""
        reader = pick(rng, self.readers)
        words: Words = COMMANDS[reader] if isinstance(reader, str) else reader
        if not self.files:
            return damaged_words(rng, words)
        path = folder / (name := pick(rng, self.files))
        if path.parent.name == "arms" and chance(rng, 0.5):  # as of an unfinished comparison
            (path.parents[1] / "trials.parquet").unlink()
        (misplaced if chance(rng, 0.04) else self.damage)(rng, path)
        return tuple(word.replace("{file}", name) for word in words)


def damaged_words(rng: Generator, sound: Words) -> Words:
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
def options_of(command: str) -> tuple[str, ...]:
    """Options of a command, and one that it has not."""
    options = [word for action in parser_of(command)._actions for word in action.option_strings]
    return (*(word for word in options if word.startswith("--")), "--nothing")


STORE = ("explore", *["walk of a row"] * 3, "study", "compare", COMPARE_NEW)
TERRAIN = ("walk", "--config", "{file}.toml", *STILL)
DATABASE = ("walk of a live trial", "study", (*STUDY, "--trials", "3"),
            ("dashboard", "--storage", "sqlite:///live.db", "--port", "0"),
            (*COMPARE_NEW, "--storage", "sqlite:///live.db"))  # fmt: skip
EXPORTED = ("compare", "dashboard", "walk of an exported trial")
SHARD = ("store/part-00000.parquet",)

FORMATS = (
    Format("arguments", 20, (), tuple(COMMANDS)),
    Format("experiment, TOML", 16, ("toy.toml",),
           ("walk", "compare", COMPARE_NEW, (*NEW_STUDY, "dog"), (*NEW_STUDY, "random")), in_toml),
    Format("experiment on MuJoCo, TOML", 4, ("mujoco-rough8.toml",), (WALK_SOFT,), in_toml),
    Format("store, TOML", 8, ("grid.toml",), ("precompute", *[PRECOMPUTE_NEW] * 2), in_toml),
    Format("store of worlds, TOML", 2, ("store-worlds.toml",), (PRECOMPUTE_WORLDS,), in_toml),
    Format("gains, JSON", 10, ("gains.json", "best/dog-run-000-best.json"),
           (("walk", "--gains", "{file}", *STILL),), in_json),
    Format("terrain table", 10, ("hill.csv", "hill.csv.gz", "hill.csv.bz2", "hill.csv.xz"),
           (TERRAIN,), in_text),
    Format("store's manifest", 6, ("store/manifest.json",), STORE, in_json),
    Format("store's shard, bytes", 6, SHARD, STORE, in_bytes),
    Format("store's footer", 6, SHARD, STORE, in_footer),
    Format("store's columns", 5, SHARD, STORE, in_columns),
    Format("store that goes on", 5,
           ("grid/specification.json", "grid/manifest.json", "grid/part-00001.parquet"),
           (PRECOMPUTE, PRECOMPUTE, (*PRECOMPUTE, "--fresh")), in_folder_file),
    Format("experiment.json", 6, ("compared/experiment.json",),
           ("report", "report", "compare", "walk of a trial"), in_json),
    Format("run.json", 3, ("compared/run.json",), ("report", "report", "compare"), in_json),
    Format("trials.parquet", 6, ("compared/trials.parquet",), ("report", *["walk of a trial"] * 2),
           either(in_bytes, in_columns)),
    Format("an arm's trials", 6, ("compared/arms/dog.parquet", "compared/arms/random.parquet"),
           ("report", "compare", "compare"), either(in_bytes, in_columns, in_columns, in_footer)),
    Format("live studies, SQLite", 7, ("live.db",), DATABASE, in_database),
    Format("a comparison's studies, SQLite", 3, ("compared/studies.db",), EXPORTED, in_database),
)  # fmt: skip

SHARES = np.array([each.share for each in FORMATS], dtype=float)
NAMES = tuple(each.name for each in FORMATS)
HERE = "here"  # of a case, where its command is run: a ".." leads no farther than the case


@dataclass(frozen=True)
class Case:
    """A numbered case: its format's name, the words of its command, and the folder to run it in."""

    number: int
    name: str
    words: Words
    folder: Path


def make_case(seed: int, number: int, world: Path, place: Path) -> Case:
    """Make the case's folder, of the sound files of `world`, in `place`, which is for it alone."""
    shutil.rmtree(place, ignore_errors=True)
    folder = Path(shutil.copytree(world, place / HERE))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    chosen = FORMATS[int(rng.choice(len(FORMATS), p=SHARES / SHARES.sum()))]
    return Case(number, chosen.name, chosen.prepare(rng, folder), folder)
