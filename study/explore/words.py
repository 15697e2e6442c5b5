"""The columns of a store in words: with units, in groups, and each with a line that explains it.

The words follow from the names: the store's families, the walker's fields and
parameters, and the abbreviations of choices.toml.
"""

import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from storage.simulator import WALKER
from storage.store import Store
from study.pictures.gait_cycle import PEOPLE
from taichi_nmm.parameters import GAINS
from taichi_nmm.result import FURTHER_FIELDS, SUMMARY_FIELDS

Tables = dict[str, Any]
"""Plain values by their names, such as a table of a configuration."""

CHOICES: Tables = tomllib.loads(
    Path(__file__).with_name("choices.toml").read_text(encoding="utf-8")
)
MUSCLES = {muscle.lower(): words for muscle, words in PEOPLE["muscles"].items()}
WORDS = MUSCLES | CHOICES["words"]
STATISTICS = {
    "mean": "mean over its worlds",
    "sd": "standard deviation over its worlds",
}
OUTCOME = "outcome and score"
GAIT = "gait"
GAIN = "gains"
Menu = dict[str, list[tuple[str, str]]]
"""Options by group: a column's name and its words."""


class Described(NamedTuple):
    """A column in words.

    Attributes:
        group: of the menu, under which it is listed.
        words: its name for people, with the unit.
        meaning: a line that explains it.
    """

    group: str
    words: str
    meaning: str


def described(store: Store, names: list[str]) -> dict[str, Described]:
    """These columns of a store, by name."""
    walker = store.simulator == WALKER
    gains = {gain.name: gain for gain in GAINS if walker}
    gait = dict((*SUMMARY_FIELDS, *FURTHER_FIELDS)) if walker else {}
    found = {}
    for name in names:
        # The longest: a name may begin another one.
        families = [each for each in store.families if name.startswith(f"{each}_")]
        family = max(families, key=len, default="")
        words, last = in_words(name.removeprefix(f"{family}_") if family else name)
        group = GAIT if name in gait else OUTCOME
        meaning = CHOICES["meanings"].get(name, "")
        meaning += (
            "in the base setting" if store.ROW == "row" else f"of the {store.ROW}"
        )
        if name in gains:
            gain = gains[name]
            group, words = GAIN, f"{name} ({gain.unit})"
            meaning = f"{gain.meaning}; {gain.low:g} to {gain.high:g} {gain.unit}"
        elif name in store.parameter_names:
            group, words, meaning = GAIN, name, "a searched parameter"
        elif family:
            statistic = STATISTICS.get(last, "whether the row was tried")
            group, words = f"family {family}", f"{family}: {words}"
            meaning = f"{statistic}, {group}"
        found[name] = Described(group=group, words=words, meaning=meaning)
    return found


def in_words(name: str) -> tuple[str, str]:
    """The words of a name with its unit, and its last word before the unit."""
    *parts, last = name.split("_")
    if name in CHOICES["names"]:
        return CHOICES["names"][name], last
    unit = CHOICES["units"].get(last) if parts else None
    parts = parts if unit else [*parts, last]
    text = " ".join(WORDS.get(part.lower(), part) for part in parts)
    return (f"{text} ({unit})" if unit else text), parts[-1]


def menu(columns: dict[str, Described]) -> Menu:
    """The columns by group."""
    groups: Menu = {}
    for name, column in columns.items():
        groups.setdefault(column.group, []).append((name, column.words))
    return groups
