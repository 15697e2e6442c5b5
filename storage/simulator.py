"""The seam: what a store knows of the simulator whose scores it keeps.

A store is of *a simulator*: points of its parameters, worlds drawn by a rule and a seed, and a row
of columns for every point in every world. Nothing else in this package depends on what is
simulated. CONTRIBUTING.md says how to add a simulator.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.config import Table
from taichi_nmm.errors import InputError

WALKER = "walker"
SIMULATORS = {WALKER: "taichi_nmm.walker_simulator:Walker"}  # imported when a store needs one
SIMULATOR_KEY = "simulator"  # of a specification; those of the walker are older and lack it

# Columns that every simulator has.
LASTED = "duration_s"  # of a run, until it failed or the horizon was over
END = "end_reason"  # index into the simulator's words for it; 0: the horizon was over
SURVIVED = "survived_fraction"  # share of the horizon that a run lasted; one of the scores

Report = Callable[[float], None]
"""Called with the fraction of the work that is done."""

Worlds = Any
"""Worlds that a rule has drawn, of whatever type its simulator takes. They pickle."""


class Parameter(Protocol):
    """A coordinate of a point."""

    @property
    def name(self) -> str:
        """Of its column."""

    @property
    def low(self) -> float:
        """Lower bound."""

    @property
    def high(self) -> float:
        """Upper bound."""


class WorldRule(Protocol):
    """What worlds are drawn from, such as a kind of ground with ranges of its options."""

    def draw(self, seeds: Sequence[np.random.SeedSequence]) -> Worlds:
        """One world a seed; each depends on its own seed alone."""

    def document(self, worlds: Worlds) -> dict[str, Any]:
        """The rule, and the worlds that were drawn by it, as JSON values."""


class Simulator(Protocol):
    """A simulator with its settings. It pickles: any process runs points with it."""

    @classmethod
    def read(cls, settings: Table, searched: Sequence[str], arch: str | None) -> Self:
        """The simulator that a configuration describes.

        Args:
            settings: the table [simulation]; keys that are not read are refused.
            searched: names of parameters that points have beside the usual ones.
            arch: what computes, where the command line overrides the configuration.

        Raises:
            InputError: a value out of range.
        """

    @classmethod
    def parameters_of(cls, names: Sequence[str]) -> tuple[Parameter, ...]:
        """The usual parameters, and those of these names that can be searched beside them."""

    @property
    def name(self) -> str:
        """Of the simulator, in a specification."""

    @property
    def code_version(self) -> str:
        """Of the code that computes: shards of two versions do not mix."""

    @property
    def packages(self) -> tuple[str, ...]:
        """Installed packages whose versions decide results."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What a point consists of, [p]."""

    @property
    def columns(self) -> np.dtype[np.void]:
        """Of a run's row; `LASTED`, `END` and `SURVIVED` are among them."""

    @property
    def ends(self) -> tuple[str, ...]:
        """How a run may end, in words, such as "completed" and "fell"; stores keep the words."""

    @property
    def scores(self) -> tuple[str, ...]:
        """Columns of which a store keeps mean and spread over the worlds of a family."""

    @property
    def objective(self) -> str:
        """What a search for candidates maximises, by name."""

    @property
    def measures(self) -> Mapping[str, tuple[float, float]]:
        """Columns that tell candidates apart, with the ranges that a search covers.

        {}: no search can be asked for.
        """

    def document(self) -> dict[str, Any]:
        """All settings that decide results, as JSON values; those of the table "simulation" too."""

    def versions(self) -> dict[str, str]:
        """Versions that a specification has to name beside `code_version`, by key.

        Raises:
            InputError: something is not installed.
        """

    def read_worlds(self, table: Table) -> WorldRule:
        """The rule in the tables of a family, or of the whole configuration for its base setting.

        Raises:
            InputError: a value out of range.
        """

    def run(
        self, points: NDArray[np.float64], worlds: Worlds, horizon_s: float, report: Report
    ) -> tuple[NDArray[np.void], dict[str, Any]]:
        """Run every point in every world.

        Args:
            points: [n, p].
            worlds: w of them, as a rule of `read_worlds` has drawn them.
            horizon_s: after which a run is over.
            report: called with the fraction that is done.

        Returns:
            Rows of `columns`, [n, w], each of which depends on its point, its world and the horizon
            alone; and what computed them, as JSON values for the footer of a file.
        """

    def judge(
        self, rows: NDArray[np.void], horizon_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Objective [n] and measures [n, m] of points with these rows, [n, w], for a search."""

    def canary(self) -> NDArray[np.void]:
        """Rows of a small fixed batch, by whose bits machines are told apart."""

    def on_one_thread(self) -> Self:
        """The same for one of several processes of a machine; no result depends on it."""

    def require_machine(self) -> None:
        """Refuse a machine on which it cannot run; nothing is written.

        Raises:
            InputError: naming what is missing.
        """

    def processes(self, cores: int) -> int:
        """How many processes of a machine with so many cores should work side by side."""


def find_simulator(name: str) -> type[Simulator]:
    """The simulator of this name, or a class of an importable module: "package.module:Class".

    Raises:
        InputError: there is none.
    """
    module, _, attribute = SIMULATORS.get(name, name).partition(":")
    allowed = f"{' or '.join(SIMULATORS)}, or a class that can be imported: package.module:Class"
    if not attribute:
        raise InputError(SIMULATOR_KEY, name, allowed)
    try:
        found: type[Simulator] = getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(SIMULATOR_KEY, name, f"{allowed} ({error})") from None
    return found


def known_simulator(specification: Mapping[str, Any]) -> type[Simulator]:
    """The simulator of a store that was read; no file can have other code imported.

    Raises:
        InputError: the store is of a simulator that is not one of `SIMULATORS`.
    """
    name = specification.get(SIMULATOR_KEY, WALKER)
    if name not in SIMULATORS:
        raise InputError(f"store.{SIMULATOR_KEY}", name, " or ".join(SIMULATORS))
    return find_simulator(name)
