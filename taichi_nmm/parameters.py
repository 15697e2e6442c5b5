"""The searched gains and the fixed ones: names, units, bounds, meaning and source.

Sources: P = Antonova, Rai, Atkeson 2016; T = the transfemoral-prosthesis walker of the
same group (``IntactModel``), whose published rough-ground optimum gives
`PUBLISHED_GAINS` and the fixed gains.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.inputs import checks
from storage.inputs.config import Table
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import json_document


@dataclass(frozen=True)
class Parameter:
    """One gain of the controller.

    Attributes:
        name: as in `gains` by name, and the column of a store.
        unit: of its values; "1" where they are shares or factors of F/Fmax.
        low: lower bound of the search, in this unit.
        high: upper bound, in this unit.
        default: the published value, or for a device and an asymmetry the one of a
            walker without it.
        meaning: in a few words.
        source: P or T above, P with the number of the gain there; or another
            publication.
    """

    name: str
    unit: str
    low: float
    high: float
    default: float
    meaning: str
    source: str


def _group(name: str) -> tuple[Parameter, ...]:
    """The parameters of a group, from parameters.csv."""
    with Path(__file__).with_suffix(".csv").open(encoding="utf-8", newline="") as file:
        rows: list[Any] = [
            row for row in csv.DictReader(file) if row.pop("group") == name
        ]
    numbers = ("low", "high", "default")
    return tuple(
        Parameter(**row | {key: _number(row[key]) for key in numbers}) for row in rows
    )


def _number(text: str) -> float:
    """A cell's number; angles are in degrees there, in rad here."""
    number, _, unit = text.partition(" ")
    return float(np.deg2rad(float(number))) if unit == "deg" else float(number)


# Force gains multiply F/Fmax. Bounds: wide enough that about 6 % of uniform draws walk
# 100 s on flat ground. Defaults: PUBLISHED_GAINS, T's published rough-ground optimum.
GAINS: tuple[Parameter, ...] = _group("searched")
"""The 16 searched gains, in the order of a row of `gains`."""

DEVICE: tuple[Parameter, ...] = _group("device")  # exoskeleton: `kernel.device`


def _asymmetry(gain: Parameter) -> Parameter:
    # Half of what would take one leg from the middle of the gain's range to its end.
    reach = 0.5 * (gain.high - gain.low) / (gain.high + gain.low)
    mean = f"{gain.name}, which is the mean of both"
    return Parameter(
        name=f"{gain.name}_asymmetry",
        unit="1",
        low=-reach,
        high=reach,
        default=0.0,
        meaning=f"(left - right) / (left + right) of {mean}",
        source="ours",
    )


ASYMMETRIES: tuple[Parameter, ...] = tuple(map(_asymmetry, GAINS))
"""How far each gain differs by side: the left leg has K (1 + a), the right one K (1 - a)."""

# Not searched by the paper, but of the same form, so that a later study can search
# them.
FIXED: tuple[Parameter, ...] = _group("fixed")
LOW_LEVEL_GAINS: tuple[Parameter, ...] = (*FIXED, *DEVICE, *ASYMMETRIES)
"""8 fixed gains, 4 numbers of a device, 16 asymmetries: in the order of `low_level_gains`."""

GAIN_NAMES: tuple[str, ...] = tuple(parameter.name for parameter in GAINS)
"""Names of the searched gains, [16]."""

LOW_LEVEL_NAMES: tuple[str, ...] = tuple(
    parameter.name for parameter in LOW_LEVEL_GAINS
)

PUBLISHED_GAINS: NDArray[np.float64] = np.array(
    [parameter.default for parameter in GAINS]
)
"""T's published rough-ground optimum, [16]."""

NAMED_GAINS_DIRECTORY = Path(__file__).parent / "gains"
RENAMED = {"K_T": "published, its name since version 0.3"}


def lower_bounds() -> NDArray[np.float64]:
    """Lower bounds of the searched gains, [16]."""
    return np.array([parameter.low for parameter in GAINS])


def upper_bounds() -> NDArray[np.float64]:
    """Upper bounds of the searched gains, [16]."""
    return np.array([parameter.high for parameter in GAINS])


def searched_parameters(names: Sequence[str]) -> tuple[Parameter, ...]:
    """The low-level gains of these names, each once, in the order of `LOW_LEVEL_GAINS`.

    Raises:
        InputError: an unknown name.
    """
    for name in names:
        if name not in LOW_LEVEL_NAMES:
            raise InputError(
                "searched", name, f"any of {listed(LOW_LEVEL_NAMES, name)}"
            )
    return tuple(parameter for parameter in LOW_LEVEL_GAINS if parameter.name in names)


def read_fixed(table: Table) -> tuple[float, ...]:
    """The key `fixed_gains` of a configuration: the 16 gains if none of them is searched, or none.

    They are a source of `load_gains`, or a table of gains by name.

    Raises:
        InputError: another value, or nothing is left to search.
    """
    if not table.has("fixed_gains"):
        return ()
    if isinstance(table.unread["fixed_gains"], dict):
        given = table.table("fixed_gains")
        values = {name: given.number(name) for name in list(given.unread)}
        fixed = check_gains(values, field="fixed_gains")
    else:
        fixed = load_gains(table.text("fixed_gains"))
    if not table.unread.get("searched"):
        raise InputError(
            "searched", "nothing", "some low-level gains, where all gains are fixed"
        )
    return tuple(fixed.tolist())


def split_points(
    points: NDArray[np.float64],
    searched: tuple[Parameter, ...],
    fixed: tuple[float, ...] = (),
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points as arguments of `taichi_nmm.simulate`: gains [n, 16] and low-level gains [n, 28].

    Args:
        points: [n, 16 + k], or [n, k] where the gains are fixed.
        searched: the k low-level gains in the last columns; the others keep their
            defaults.
        fixed: the 16 gains, or none.
    """
    low_level = np.tile(
        [parameter.default for parameter in LOW_LEVEL_GAINS], (len(points), 1)
    )
    gains = np.tile(fixed, (len(points), 1)) if fixed else points[:, : len(GAINS)]
    for column, parameter in enumerate(searched, start=points.shape[1] - len(searched)):
        low_level[:, LOW_LEVEL_NAMES.index(parameter.name)] = points[:, column]
    return gains, low_level


def gain_rows(
    values: ArrayLike, group: tuple[Parameter, ...] = GAINS, field: str = "gains"
) -> NDArray[np.float64]:
    """Check a batch of gains and return it as float64 [n, len(group)].

    Values outside the search bounds are allowed (a published vector may lie there);
    values that are not finite, no rows, or another shape, are an `InputError`.
    """
    rows = np.atleast_2d(checks.numbers(field, values))
    if rows.ndim != 2 or rows.shape[1] != len(group) or not len(rows):
        allowed = f"[n, {len(group)}] or [{len(group)}], of one row at least"
        raise InputError(f"{field}.shape", np.shape(values), allowed)
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        row, column = (int(index) for index in bad[0])
        name = group[column].name
        raise InputError(
            f"{field}[{row}].{name}", float(rows[row, column]), "a finite number"
        )
    return rows


def check_gains(
    values: Mapping[str, Any],
    group: tuple[Parameter, ...] = GAINS,
    field: str = "gains",
) -> NDArray[np.float64]:
    """Gains by name as a vector in the group's order, float64 [len(group)].

    Raises:
        InputError: a name that is unknown or missing, or a value that is not a number
            within the parameter's bounds.
    """
    names = [parameter.name for parameter in group]
    for name in values:
        if name not in names:
            raise InputError(field, name, f"only the names {listed(names, name)}")
    within = (
        (p.name, checks.number(p.low, p.high, f"{p.low:g} to {p.high:g}"))
        for p in group
    )
    return np.array(
        [check(f"{field}.{name}", values.get(name)) for name, check in within], float
    )


@checks.checked(source=checks.path)
def load_gains(source: str) -> NDArray[np.float64]:
    """Gains by name or from a JSON file, [16].

    Args:
        source: "published", the name of a file in `taichi_nmm/gains`, or the path of a
            JSON file: one object with exactly the names of `GAINS` as keys, angles in
            rad, or an object that holds such a one under "gains", as commands print it.

    Raises:
        InputError: a source that is not there or no such file, a value outside its
            bounds, or a low-level gain: dropping it would walk another controller
            (`load_all_gains`).
    """
    values = _gains_by_name(source)
    for name in values:
        if name in LOW_LEVEL_NAMES:
            allowed = f"the {len(GAINS)} gains alone; load_all_gains takes low-level gains too"
            raise InputError("gains", name, allowed)
    return check_gains(values)


@checks.checked(source=checks.path)
def load_all_gains(source: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gains [16] and low-level gains [28], from a source of `load_gains`.

    Here a file may name some of `LOW_LEVEL_GAINS` too; those it does not name have
    their defaults.

    Raises:
        InputError: a source that is not there or no such file, or a value outside its
            bounds.
    """
    defaults = {parameter.name: parameter.default for parameter in LOW_LEVEL_GAINS}
    both = check_gains(defaults | _gains_by_name(source), (*GAINS, *LOW_LEVEL_GAINS))
    gains, low_level = np.split(both, [len(GAINS)])
    return gains, low_level


def _gains_by_name(source: str) -> dict[str, Any]:
    """The values of a source by name, unchecked."""
    if source == "published":
        return dict(zip(GAIN_NAMES, PUBLISHED_GAINS.tolist(), strict=True))
    if source in RENAMED and not Path(source).exists():
        raise InputError("gains", source, RENAMED[source])
    shipped = {file.stem: file for file in sorted(NAMED_GAINS_DIRECTORY.glob("*.json"))}
    names = listed(["published", *shipped], source)
    allowed = f"one of {names}; or a JSON file: a readable JSON object of the {len(GAINS)} gains"
    data = json_document("gains", shipped.get(source, source), allowed)
    values = data.get("gains", data)
    if not isinstance(values, dict):
        raise InputError("gains", source, allowed)
    return values
