"""A case: a folder of sound files of which one is damaged, and the words of a command.

Case n of a seed is the same on every machine, and depends on no other.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.fuzz.formats import FORMATS
from tests.fuzz.world import Words

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
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    shutil.rmtree(place, ignore_errors=True)
    folder = Path(shutil.copytree(world, place / HERE))
    chosen = FORMATS[int(rng.choice(len(FORMATS), p=SHARES / SHARES.sum()))]
    return Case(number, chosen.name, chosen.prepare(rng, folder), folder)
