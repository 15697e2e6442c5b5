"""The searched gains and the fixed ones: names, units, bounds, meaning and source.

Sources: P = Antonova, Rai, Atkeson 2016; T = the transfemoral-prosthesis walker of the same group
(``IntactModel``), whose published rough-ground optimum gives `PUBLISHED_GAINS` and the
fixed gains.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_nmm import checks
from taichi_nmm.errors import InputError
from taichi_nmm.reading import json_document


@dataclass(frozen=True)
class Parameter:
    """One gain of the controller: its name, bounds, default, meaning and source."""

    name: str
    unit: str
    low: float
    high: float
    default: float
    meaning: str
    source: str


# Force gains multiply F/Fmax. Bounds: wide enough that about 6 % of uniform draws walk 100 s on
# flat ground. Defaults: PUBLISHED_GAINS, T's published rough-ground optimum.
GAINS: tuple[Parameter, ...] = (
    Parameter("K_GAS", "1", 0.0, 8.0, 3.874, "positive force feedback of gastrocnemius", "P 1"),
    Parameter("K_GLU", "1", 0.0, 3.0, 0.5755, "positive force feedback of gluteus", "P 2"),
    Parameter("K_HAM", "1", 0.0, 3.0, 0.1282, "positive force feedback of hamstrings", "P 3"),
    Parameter("K_SOL", "1", 0.0, 24.0, 16.58, "positive force feedback of soleus", "P 4"),
    Parameter("K_TA_SOL", "1", 0.0, 8.0, 3.879, "inhibition of tibialis by soleus force", "P 5"),
    Parameter("K_TA", "1", 0.0, 9.0, 4.727, "positive length feedback of tibialis", "P 6"),
    Parameter("K_VAS", "1", 0.0, 8.0, 1.989, "positive force feedback of vastus", "P 7"),
    Parameter("Kp_stance", "1/rad", 0.0, 9.0, 4.572, "trunk lean onto hip muscles", "P 8"),
    Parameter("Kd_stance", "s/rad", 0.0, 2.0, 0.5131, "trunk rate onto hip muscles", "P 9"),
    Parameter("K_mix_GLU", "1", 0.0, 3.5, 1.492, "share of trunk feedback to gluteus", "P 10"),
    Parameter("Kp_swing", "N m/rad", 5.0, 300.0, 63.94, "hip torque on leg-angle error", "P 11"),
    Parameter("Kd_swing", "N m s/rad", 0.0, 45.0, 17.54, "hip torque on leg-angle rate", "P 12"),
    Parameter(
        "alpha_0", "rad", np.deg2rad(55.0), np.deg2rad(92.0), np.deg2rad(70.57),
        "nominal target leg angle, 90 deg is vertical", "P 13",
    ),
    Parameter("C_d", "rad/m", 0.0, 0.5, 0.00476, "target angle per distance CoM - ankle", "P 14"),
    Parameter("C_v", "rad s/m", 0.0, 0.5, 0.02548, "target angle per CoM speed", "P 15"),
    Parameter("l_clr", "m", 0.55, 0.99, 0.7591, "leg length that counts as cleared", "P 16"),
)  # fmt: skip
"""The 16 searched gains, in the order of a row of `gains`."""

# Not searched by the paper, but of the same form, so that a later study can search them.
LOW_LEVEL_GAINS: tuple[Parameter, ...] = (
    Parameter("k_oe", "1/rad", 0.0, 10.0, 1.0204, "knee over-extension inhibits vastus", "T"),
    Parameter("k_flex", "N m s/rad", 0.0, 50.0, 7.95, "knee flexion on leg-angle rate", "T"),
    Parameter("k_hold_1", "N m s/rad", 0.0, 50.0, 10.28, "knee damping, flexing", "T"),
    Parameter("k_hold_2", "N m s/rad", 0.0, 50.0, 0.400, "knee damping, extending", "T"),
    Parameter("k_stop", "N m/rad", 0.0, 500.0, 6.72, "stop of the leg near its target", "T"),
    Parameter("k_ext", "N m/m", 0.0, 1500.0, 577.1, "knee extension before landing", "T"),
    Parameter("w_filter", "1/s", 10.0, 500.0, 64.47, "leg-angle rate filter", "T"),
    Parameter(
        "theta_ref", "rad", np.deg2rad(-10.0), np.deg2rad(30.0), np.deg2rad(6.0),
        "torso reference angle, forward positive", "T",
    ),
)  # fmt: skip
"""The 8 fixed gains, in the order of a row of `low_level_gains`."""

GAIN_NAMES: tuple[str, ...] = tuple(parameter.name for parameter in GAINS)
"""Names of the searched gains, [16]."""

LOW_LEVEL_NAMES: tuple[str, ...] = tuple(parameter.name for parameter in LOW_LEVEL_GAINS)

PUBLISHED_GAINS: NDArray[np.float64] = np.array([parameter.default for parameter in GAINS])
"""T's published rough-ground optimum, [16]."""

NAMED_GAINS_DIRECTORY = Path(__file__).parent / "gains"


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
            raise InputError("searched", name, f"any of {', '.join(LOW_LEVEL_NAMES)}")
    return tuple(parameter for parameter in LOW_LEVEL_GAINS if parameter.name in names)


def split_points(
    points: NDArray[np.float64], searched: tuple[Parameter, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points as arguments of `taichi_nmm.simulate`: gains [n, 16] and low-level gains [n, 8].

    Args:
        points: [n, 16 + k].
        searched: the k low-level gains in the last columns; the others keep their defaults.
    """
    low_level = np.tile([parameter.default for parameter in LOW_LEVEL_GAINS], (len(points), 1))
    for column, parameter in enumerate(searched, start=len(GAINS)):
        low_level[:, LOW_LEVEL_NAMES.index(parameter.name)] = points[:, column]
    return points[:, : len(GAINS)], low_level


def gain_rows(
    values: ArrayLike, group: tuple[Parameter, ...] = GAINS, field: str = "gains"
) -> NDArray[np.float64]:
    """Check a batch of gains and return it as float64 [n, len(group)].

    Values outside the search bounds are allowed (a published vector may lie there); values that
    are not finite, or another shape, are an `InputError`.
    """
    rows = np.atleast_2d(checks.numbers(field, values))
    if rows.ndim != 2 or rows.shape[1] != len(group):
        raise InputError(f"{field}.shape", np.shape(values), f"[n, {len(group)}] or [{len(group)}]")
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        row, column = (int(index) for index in bad[0])
        name = group[column].name
        raise InputError(f"{field}[{row}].{name}", float(rows[row, column]), "a finite number")
    return rows


def check_gains(
    values: Mapping[str, Any], group: tuple[Parameter, ...] = GAINS, field: str = "gains"
) -> NDArray[np.float64]:
    """Gains by name as a vector in the group's order, float64 [len(group)].

    Raises:
        InputError: a name that is unknown or missing, or a value that is not a number within the
            parameter's bounds.
    """
    names = [parameter.name for parameter in group]
    for name in values:
        if name not in names:
            raise InputError(field, name, f"only the names {' '.join(names)}")
    return np.array([_within_bounds(values.get(p.name), p, f"{field}.{p.name}") for p in group])


def _within_bounds(value: Any, parameter: Parameter, field: str) -> float:
    bounds = f"{parameter.low:g} to {parameter.high:g}"
    if not checks.is_number(value):
        too_large = isinstance(value, int) and not isinstance(value, bool)  # for any float
        raise InputError(field, value, bounds if too_large else "a number")
    if not math.isfinite(value):
        raise InputError(field, value, "a finite number")
    if not parameter.low <= value <= parameter.high:
        raise InputError(field, value, bounds)
    return float(value)


@checks.checked(source=checks.path)
def load_gains(source: str) -> NDArray[np.float64]:
    """Gains by name (``published``, or a file in ``taichi_nmm/gains``) or from a JSON file, [16].

    The file is one object with exactly the names of `GAINS` as keys, angles in rad, or an object
    that holds such a one under "gains", as commands print it.

    Raises:
        InputError: a source that is not there or no such file, a value outside its bounds, or a
            low-level gain: dropping it would walk another controller (`load_all_gains`).
    """
    values = _gains_by_name(source)
    for name in values:
        if name in LOW_LEVEL_NAMES:
            allowed = f"the {len(GAINS)} gains alone; load_all_gains takes low-level gains too"
            raise InputError("gains", name, allowed)
    return check_gains(values)


@checks.checked(source=checks.path)
def load_all_gains(source: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gains [16] and low-level gains [8], from a source of `load_gains`.

    Here a file may name some of `LOW_LEVEL_GAINS` too; those it does not name have their defaults.

    Raises:
        InputError: a source that is not there or no such file, or a value outside its bounds.
    """
    defaults = {parameter.name: parameter.default for parameter in LOW_LEVEL_GAINS}
    both = check_gains(defaults | _gains_by_name(source), (*GAINS, *LOW_LEVEL_GAINS))
    gains, low_level = np.split(both, [len(GAINS)])
    return gains, low_level


def _gains_by_name(source: str) -> dict[str, Any]:
    """The values of a source by name, unchecked."""
    if source in ("published", "K_T"):  # K_T: its name before 0.3.0, accepted until 0.4.0
        return dict(zip(GAIN_NAMES, PUBLISHED_GAINS.tolist(), strict=True))
    shipped = {file.stem: file for file in sorted(NAMED_GAINS_DIRECTORY.glob("*.json"))}
    names = ", ".join(["published", *shipped])
    allowed = f"one of {names}; or a JSON file: a readable JSON object of the {len(GAINS)} gains"
    data = json_document("gains", shipped.get(source, source), allowed)
    values = data.get("gains", data)
    if not isinstance(values, dict):
        raise InputError("gains", source, allowed)
    return values
