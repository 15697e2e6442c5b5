"""Worlds that somebody measured, with no simulator in between.

A *family* is one thing that was measured on several machines: the run times of a GPU
kernel on GPUs, the yields of a reaction with substrates. Each machine in turn is the
target, which is costly to try; the others are its worlds. The files are read as their
publishers have them. None of them is in this repository: `FAMILIES` says where to get
them.
"""

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from storage.foreign_tables import ForeignTable
from storage.inputs.errors import InputError
from storage.inputs.reading import is_folder, json_document, reading
from tools.runs import Columns, Floats, Pool

Candidate = tuple[float | int | str, ...]  # values of the parameters
ByMachine = Mapping[str, Mapping[Candidate, float]]

CACHE_FILE = "a cache file of Kernel Tuner, with tune_params and cache"
FULL_YIELD = 100.0  # %
# GPUs of one maker; of the RTX cards, all of one maker, those of one generation
KINDS = (
    ("A100", "A4000", "A6000"),
    ("MI250X", "W6600", "W7800"),
    ("RTX_2080_Ti", "RTX_Titan"),
    ("RTX_3060_laptop", "RTX_3090"),
)
OTHER_UNITS = 1000.0  # two machines' times that differ so much are perhaps in two units
HALOGEN = re.compile("Cl|Br|I")  # of an aryl halide's SMILES


@dataclass(frozen=True, eq=False)
class Measurements:
    """What was measured of n candidates on each of m machines.

    Attributes:
        names: of the parameters, [d].
        machines: their names, [m].
        columns: of the parameters, [n] each.
        costs: less is better; infinite where it failed, [n, m].
        files: that they were read from.
    """

    names: tuple[str, ...]
    machines: tuple[str, ...]
    columns: Columns
    costs: Floats
    files: tuple[Path, ...]

    @classmethod
    def of(
        cls, names: Sequence[str], found: ByMachine, files: Sequence[Path]
    ) -> "Measurements":
        """The candidates that every machine has; parameters of one value are left out.

        Raises:
            InputError: fewer than two machines, no common candidates, or a machine on
                which every candidate failed.
        """
        field, folder = "data", str(files[0].parent) if files else "none"
        if len(found) < 2:
            raise InputError(field, folder, "measurements on two machines or more")
        first, *others = found.values()
        common = [each for each in first if all(each in other for other in others)]
        if not common:
            raise InputError(field, folder, "machines with candidates in common")
        costs = np.array([[costs[each] for costs in found.values()] for each in common])
        for machine, ran in zip(found, np.isfinite(costs).any(axis=0), strict=True):
            if not ran:
                allowed = (
                    f"a candidate that did not fail on {machine}, of those in common"
                )
                raise InputError(field, folder, allowed)
        every = (np.array(values) for values in zip(*common, strict=True))
        columns = {
            name: column
            for name, column in zip(names, every, strict=True)
            if len(np.unique(column)) > 1
        }
        return cls(tuple(columns), tuple(found), columns, costs, tuple(files))


def read_kernel(folder: Path) -> Measurements:
    """Run times of a kernel in ms, a file a GPU, as Kernel Tuner keeps them.

    Raises:
        InputError: a file of another kind, or of other parameters than the first;
            or as of `Measurements.of`.
    """
    files, names, found = sorted(folder.glob("*.json.gz")), list[str](), {}
    for file in files:
        document = json_document("data", file, CACHE_FILE)
        with reading("data", file, CACHE_FILE):
            own = [*document["tune_params"]]
            names = names or own
            if own != names:
                allowed = f"the parameters of {files[0].name}: {', '.join(names)}"
                raise InputError("data", f"{file}: {', '.join(own)}", allowed)
            found[file.name.removesuffix(".json.gz")] = {
                tuple(entry[name] for name in names): _time(entry["time"])
                for entry in document["cache"].values()
            }
    measured = Measurements.of(names, found, files)
    _say_units(folder, measured)
    return measured


def _time(told: float | str) -> float:
    """A time in ms; where the kernel failed, a word is told, and the time is infinite."""
    if isinstance(told, str):
        return np.inf
    if not 0.0 < told < np.inf:
        raise ValueError(f"a time of {told}")
    return float(told)


def _say_units(folder: Path, measured: Measurements) -> None:
    """Say it in a line if a machine seems to be told in other units than another."""
    least = measured.costs.min(axis=0)
    low, high = int(least.argmin()), int(least.argmax())
    if least[high] >= OTHER_UNITS * least[low]:
        slow, fast = measured.machines[high], measured.machines[low]
        times = f"{least[high] / least[low]:.3g} times"
        print(
            f"{folder}: the best of {slow} is {times} that of {fast}: in other units,"
            " perhaps; a world is told as times of its own best",
            file=sys.stderr,
        )


def read_amination(folder: Path) -> Measurements:
    """Yields that aryl aminations lack, in %; a machine is an aryl halide without its halogen."""

    def split(halide: str) -> tuple[str, str]:
        halogen = HALOGEN.search(halide)
        if halogen is None:
            raise InputError("data.Aryl_halide_SMILES", halide, "with Cl, Br or I")
        return HALOGEN.sub("*", halide), halogen[0]

    return _reactions(
        folder,
        ("Aryl_halide_SMILES",),
        ("Ligand_SMILES", "Additive_SMILES", "Base_SMILES"),
        split=split,
    )


def read_coupling(folder: Path) -> Measurements:
    """Yields that Suzuki couplings lack, in %; a machine is a pair of substrates."""
    pair = ("Electrophile_SMILES", "Nucleophile_SMILES")
    return _reactions(folder, pair, ("Ligand_SMILES", "Base_SMILES", "Solvent_SMILES"))


def _reactions(
    folder: Path,
    substrates: Sequence[str],
    components: Sequence[str],
    split: Callable[[str], tuple[str, str]] | None = None,
) -> Measurements:
    """The reactions of `experiment_index.csv`; `split` parts a substrate from what may be chosen.

    Raises:
        InputError: a column is missing, a yield is no percentage, a reaction comes
            twice; or as of `Measurements.of`.
    """
    file = folder / "experiment_index.csv"
    words = (*substrates, *components)
    table = ForeignTable.read("data", file, (*words, "yield"), words)
    yields = table.numbers("yield")
    wrong = yields[~((yields >= 0.0) & (yields <= FULL_YIELD))]
    if len(wrong):
        raise InputError("data.yield", float(wrong[0]), f"0 to {FULL_YIELD:g} %")
    names = [name.removesuffix("_SMILES").lower() for name in components]
    names = [*names, "halogen"] if split else names
    found: dict[str, dict[Candidate, float]] = {}
    columns = [table.words(name) for name in words]
    for *parts, lacks in zip(*columns, FULL_YIELD - yields, strict=True):
        machine, chosen = (
            " + ".join(parts[: len(substrates)]),
            tuple(parts[len(substrates) :]),
        )
        if split:
            machine, halogen = split(machine)
            chosen = (*chosen, halogen)
        of_machine = found.setdefault(machine, {})
        if chosen in of_machine:
            again = f"{file}: {machine}: {', '.join(chosen)}"
            raise InputError("data", again, "each reaction once")
        of_machine[chosen] = float(lacks)
    return Measurements.of(names, found, [file])


class Family(NamedTuple):
    """One thing that was measured on several machines.

    Attributes:
        folder: of its files, in the folder of the data.
        read: reads this folder.
        cost: the quantity that is minimised, with its unit.
        regret: what a cost above the least is told in.
        is_time: whether a world is told as times of its own best, since machines differ
            in speed.
        source: where to get the files.
    """

    folder: str
    read: Callable[[Path], Measurements]
    cost: str
    regret: str
    is_time: bool
    source: str


HUB = (
    "https://github.com/AutoTuningAssociation/benchmark_hub, folder cachefiles"
    " (DOI 10.5281/zenodo.15364124)"
)
EDBO = (
    "https://github.com/b-shields/edbo, folder experiments/data"
    " (DOI 10.1038/s41586-021-03213-y)"
)
OLDER = HUB.replace(" (", "/KernelTuner data of currently_unused (")
TIMES = ("run time, ms", "slower than the best, %", True)
YIELDS = ("yield that is missing, %", "yield below the best, %", False, EDBO)
FAMILIES = {
    "convolution": Family("kernels/convolution_milo", read_kernel, *TIMES, HUB),
    "dedispersion": Family("kernels/dedispersion_milo", read_kernel, *TIMES, HUB),
    **{
        f"rtx_{kernel}": Family(
            f"kernels/KernelTuner data/{kernel}", read_kernel, *TIMES, OLDER
        )
        for kernel in ("convolution", "gemm", "pnpoly")
    },
    "amination": Family("reactions/aryl_amination", read_amination, *YIELDS),
    "coupling": Family("reactions/suzuki", read_coupling, *YIELDS),
}


@cache
def measurements(data: Path, family: str) -> Measurements:
    """Of a family; read once a process, and not to be written to."""
    return FAMILIES[family].read(data / FAMILIES[family].folder)


def families(data: Path) -> list[str]:
    """The families whose folder is there; a line says where to get the others.

    Raises:
        InputError: there is none.
    """
    if not is_folder(data):
        raise InputError("data", str(data), "a folder")
    found = [name for name, of in FAMILIES.items() if is_folder(data / of.folder)]
    if not found:
        places = [f"{of.folder} ({of.source})" for of in FAMILIES.values()]
        raise InputError("data", str(data), f"a folder with {' or '.join(places)}")
    for name in sorted(FAMILIES.keys() - found):
        of = FAMILIES[name]
        print(
            f"{name} is left out: no {of.folder}; get it from {of.source}",
            file=sys.stderr,
        )
    return found


@dataclass(frozen=True, eq=False)
class Target(Pool):
    """A machine, on which each trial is costly; the other machines are worlds.

    Attributes:
        family: its name.
        machine: its name.
        outcomes: of the candidates in w worlds, less is better; infinite where it
            failed, [n, w].
        kin: which worlds are of the machine's kind; all, where kinds are not known, [w].
    """

    family: str
    machine: str
    outcomes: Floats
    kin: NDArray[np.bool_]

    BY_ROW = ("cost", "outcomes")

    @property
    def is_time(self) -> bool:
        """Whether a cost is a time, of which factors matter."""
        return FAMILIES[self.family].is_time

    def regret(self, costs: Floats) -> Floats:
        """How far costs are above the least of the pool, in % of it or of the full yield."""
        least = self.cost.min()
        slower = 100.0 * (costs / least - 1.0)
        return np.asarray(slower if self.is_time else costs - least)


def names_of(data: Path, family: str) -> list[str]:
    """The names of a family's targets: its machine, or its number where that is a formula."""
    machines = measurements(data, family).machines
    is_time = FAMILIES[family].is_time
    numbers = range(1, len(machines) + 1)
    return [f"{family}-{each}" for each in (machines if is_time else numbers)]


@cache
def target(data: Path, name: str) -> Target:
    """A target by its name."""
    family = name.partition("-")[0]
    measured = measurements(data, family)
    place = names_of(data, family).index(name)
    outcomes = np.delete(measured.costs, place, axis=1)
    if FAMILIES[family].is_time:
        outcomes = outcomes / outcomes.min(axis=0)
    machine = measured.machines[place]
    kind = next((kind for kind in KINDS if machine in kind), measured.machines)
    others = np.delete(np.array(measured.machines), place)
    return Target(
        name=name,
        space={name: _space(column) for name, column in measured.columns.items()},
        columns=measured.columns,
        cost=measured.costs[:, place],
        family=family,
        machine=machine,
        outcomes=outcomes,
        kin=np.isin(others, kind),
    )


def _space(column: Any) -> BaseDistribution:
    """The distribution of a parameter whose values double, are evenly spaced, or are words."""
    values = np.unique(column).tolist()
    if isinstance(values[0], str):
        return CategoricalDistribution(values)
    low, high = values[0], values[-1]
    if isinstance(low, float):
        return FloatDistribution(low, high)
    steps = np.diff(values).tolist()
    if len(steps) > 1 and steps == values[:-1]:
        return IntDistribution(low, high, log=True)
    return IntDistribution(low, high, step=math.gcd(*steps))
