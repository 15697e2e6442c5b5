"""A case: a folder of sound files of which one is damaged, and the words of a command.

Case n of a seed is the same on every machine, and depends on no other. Beside those of seeds there
is a list: every option of every command with every hostile word, on sound files.
"""

import shutil
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from tests.fuzz.formats import FORMATS, options_of
from tests.fuzz.hostile import OPTIONS
from tests.fuzz.world import COMMANDS, Words

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


@cache
def every_option() -> tuple[Words, ...]:
    """Each option of each command with each word: as a word of its own, and after `=`.

    What stands without an option, such as a folder, is replaced by each word as well.
    """
    found: dict[Words, None] = {}
    for base in COMMANDS.values():
        places = {word: place for place, word in enumerate(base)}
        free = [place for place in range(1, len(base)) if not base[place].startswith("--")]
        for word in OPTIONS:
            for option in options_of(base[0]):
                place = places.get(option, len(base))
                found[(*base[:place], option, word, *base[place + 2 :])] = None
                found[(*base, f"{option}={word}")] = None
            for place in free:
                found[(*base[:place], word, *base[place + 1 :])] = None
    return tuple(found)


def make_case(seed: int | None, number: int, world: Path, place: Path) -> Case:
    """Make the case's folder, in place of one that is there.

    Args:
        seed: of all cases; None: of `every_option`.
        number: from 0.
        world: folder of sound files.
        place: a folder for this case alone.
    """
    shutil.rmtree(place, ignore_errors=True)
    folder = Path(shutil.copytree(world, place / HERE))
    if seed is None:
        return Case(number, "every option", every_option()[number], folder)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    chosen = FORMATS[int(rng.choice(len(FORMATS), p=SHARES / SHARES.sum()))]
    return Case(number, chosen.name, chosen.prepare(rng, folder), folder)
