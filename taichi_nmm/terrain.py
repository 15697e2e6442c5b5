"""Grounds to walk on: a height table on a uniform grid, linear between its nodes.

The kernel reads the table alone; outside it the ground is level.

A kind of terrain is a function here and a line of `KINDS`. Its signature gives the
options of a configuration's table [terrain], with their ranges and defaults.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from inspect import Parameter, signature
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    ParamSpec,
    TypeAlias,
    get_args,
    get_origin,
    get_type_hints,
)
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.inputs import checks, typed
from storage.inputs.config import REQUIRED, Table
from storage.inputs.errors import InputError
from storage.inputs.reading import read_text

GRID_START_M = -5.0
GRID_SPACING_M = 0.05  # shorter than a foot; one cell is the shortest riser
GRID_END_M = 300.0  # the fastest gaits reach 2.4 m/s in 100 s
GRID_NODES = round((GRID_END_M - GRID_START_M) / GRID_SPACING_M) + 1
GRID_X_M: NDArray[np.float64] = GRID_START_M + GRID_SPACING_M * np.arange(
    GRID_NODES, dtype=np.float64
)

P = ParamSpec("P")

TABLE = "a readable table of x_m,height_m"
# Names of a file's two columns, in metres.
HEADERS = (
    ("x_m", "height_m"),
    ("x", "height"),
)

# Above any ground that a configuration can make (stairs: 2.9 km). Up to here float32
# tells heights of 0.5 mm apart, a twentieth of the depth of a foot at rest; not much
# beyond.
HIGHEST_M = 5000.0
SHORTEST_SPACING_M = 0.001

FLAT_START_M = 9.0  # every walker gets some steps to settle


@dataclass(frozen=True)
class Option:
    """An option of a kind of terrain: the range in a configuration, and the check of callers.

    Callers from Python may go beyond the range, as far as the ground can still be made.

    Attributes:
        low: the least that a configuration may have, in the unit of the option's name.
        high: the most that it may have.
        check: of a caller's value; it raises an `InputError`.
    """

    low: float
    high: float
    check: checks.Check


_POSITIVE = checks.number(checks.LEAST_POSITIVE, allowed="a positive, finite number")
_FROM_SHORTEST = checks.number(
    SHORTEST_SPACING_M, allowed=f"a number from {SHORTEST_SPACING_M}"
)
_WITHIN_GRID = checks.number(
    GRID_START_M,
    math.nextafter(GRID_END_M, 0.0),
    f"{GRID_START_M:g} to below {GRID_END_M:g}",
)

Amplitude: TypeAlias = Annotated[float, Option(0.0, 1.0, checks.number(0.0, HIGHEST_M))]
Spacing: TypeAlias = Annotated[float, Option(0.1, 100.0, _FROM_SHORTEST)]
FlatStart: TypeAlias = Annotated[float, Option(0.0, 100.0, _WITHIN_GRID)]
Slope: TypeAlias = Annotated[float, Option(0.001, 1.0, _POSITIVE)]
Rise: TypeAlias = Annotated[float, Option(-1.0, 1.0, checks.number())]
Direction: TypeAlias = Literal["up", "down"]


def _checked(make: Callable[P, "Terrain"]) -> Callable[P, "Terrain"]:
    """Check the arguments of a kind of terrain, by the annotations of its options."""
    of_option: dict[str, checks.Check] = {"seed": checks.seed, "path": checks.path}
    for name, hint in get_type_hints(make, include_extras=True).items():
        if get_origin(hint) is Annotated:
            of_option[name] = get_args(hint)[1].check
        elif get_origin(hint) is Literal:
            of_option[name] = checks.word(*get_args(hint))
    return checks.checked("terrain.", **of_option)(make)


@dataclass(frozen=True, eq=False)
class Terrain:
    """One ground.

    Attributes:
        name: how it was made, for people.
        height_m: heights at `GRID_X_M`, within +-`HIGHEST_M`, float64 [GRID_NODES].

    Raises:
        InputError: another shape, or a height beyond these bounds.
    """

    name: str
    height_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        checks.check_fields(self, "terrain.", name=checks.text, height_m=checks.finite)
        if self.height_m.shape != (GRID_NODES,):
            raise InputError(
                "terrain.height_m.shape", self.height_m.shape, f"[{GRID_NODES}]"
            )
        highest = float(np.abs(self.height_m).max())
        if highest > HIGHEST_M:
            raise InputError(
                "terrain.height_m", highest, f"heights within +-{HIGHEST_M:g} m"
            )

    def height(self, x_m: ArrayLike) -> NDArray[np.float64]:
        """Height of the ground at some places, m.

        Args:
            x_m: along the walk, of any shape; beyond the grid the ground is level.
        """
        return np.interp(checks.numbers("x_m", x_m), GRID_X_M, self.height_m)


def flat() -> Terrain:
    """Level ground."""
    return Terrain("flat", np.zeros(GRID_NODES))


@_checked
def rough(
    seed: int | np.random.SeedSequence,
    amplitude_m: Amplitude = 0.08,
    spacing_m: Spacing = 1.0,
    flat_start_m: FlatStart = FLAT_START_M,
    slope: Rise = 0.0,
) -> Terrain:
    """Knots joined by straight slopes, each a random height above or below the last.

    Args:
        seed: of these heights.
        amplitude_m: the largest of them, up or down, 0 or more.
        spacing_m: from one knot to the next, at least 0.001.
        flat_start_m: where the first slope begins.
        slope: by which all of it rises from there on (0.04 = 4 %), in addition.
    """
    knots_x, knots = _random_walk(seed, amplitude_m, spacing_m, flat_start_m, slope)
    height = np.interp(GRID_X_M, knots_x, knots)
    return Terrain(
        f"rough +-{amplitude_m:g} m every {spacing_m:g} m{_rising(slope)}", height
    )


@_checked
def blocks(
    seed: int | np.random.SeedSequence,
    amplitude_m: Amplitude = 0.08,
    spacing_m: Spacing = 1.0,
    riser_m: Annotated[float, Option(GRID_SPACING_M, 100.0, _POSITIVE)] = 0.10,
    flat_start_m: FlatStart = FLAT_START_M,
    slope: Rise = 0.0,
) -> Terrain:
    """Level blocks, each a random height above or below the last, joined by short risers.

    Args:
        seed: of these heights.
        amplitude_m: the largest of them, up or down, 0 or more.
        spacing_m: length of a block with its riser, at least 0.001.
        riser_m: length of a riser, at the end of its block: from one grid cell to a
            whole block, which is the rough ground.
        flat_start_m: where the first block begins.
        slope: of its length by which each block is higher (0.04 = 4 %), in addition.
    """
    if not GRID_SPACING_M <= riser_m <= spacing_m:
        raise InputError(
            "terrain.riser_m", riser_m, f"{GRID_SPACING_M} to {spacing_m} (spacing_m)"
        )
    knots_x, knots = _random_walk(seed, amplitude_m, spacing_m, flat_start_m, slope)
    starts = np.column_stack([knots_x[1:] - riser_m, knots_x[1:]]).ravel()
    levels = np.column_stack([knots[:-1], knots[1:]]).ravel()
    height = np.interp(GRID_X_M, starts, levels)
    return Terrain(
        f"blocks +-{amplitude_m:g} m, risers {riser_m:g} m{_rising(slope)}", height
    )


@_checked
def ramp(
    increment: Slope = 0.04,
    segment_m: Annotated[float, Option(0.1, 300.0, _POSITIVE)] = 20.0,
    largest_slope: Slope = 0.20,
    direction: Direction = "up",
) -> Terrain:
    """A slope that grows from segment to segment; the first one is level.

    Args:
        increment: by which the slope grows with each segment, positive (0.04 = 4 %).
        segment_m: length of a segment, positive.
        largest_slope: where it grows no more, positive (0.2 = 20 %).
        direction: "up" or "down".
    """
    middle = np.maximum(GRID_X_M[:-1] + 0.5 * GRID_SPACING_M, 0.0)
    slope = _sign(direction) * np.minimum(
        np.floor(middle / segment_m) * increment, largest_slope
    )
    height = np.concatenate([[0.0], np.cumsum(slope * GRID_SPACING_M)])
    return Terrain(
        f"ramp {direction} {100 * increment:g} % per {segment_m:g} m", height
    )


@_checked
def stairs(
    rise_m: Annotated[float, Option(0.001, 1.0, _POSITIVE)] = 0.10,
    run_m: Annotated[float, Option(0.1, 100.0, _POSITIVE)] = 0.30,
    flat_start_m: FlatStart = FLAT_START_M,
    direction: Direction = "up",
) -> Terrain:
    """Level treads, with risers one grid cell long.

    Args:
        rise_m: height of a step, positive.
        run_m: length of a step, at least two grid cells.
        flat_start_m: where the first riser is.
        direction: "up" or "down".
    """
    if run_m < 2 * GRID_SPACING_M:
        raise InputError("terrain.run_m", run_m, f"at least {2 * GRID_SPACING_M}")
    count = np.floor((GRID_X_M - flat_start_m) / run_m + 1e-9) + 1.0
    height = _sign(direction) * rise_m * np.maximum(count, 0.0)
    return Terrain(f"stairs {direction} {rise_m:g} m / {run_m:g} m", height)


@_checked
def from_file(path: str | Path) -> Terrain:
    """A height table of a text file, a row of two columns x_m and height_m a line.

    x increases; the ground is linear in between, and level before the first row and
    after the last. Tabs, semicolons, commas or blanks part the columns; with other
    marks than commas, numbers may have decimal commas. Empty lines, comments after a #,
    and a first line of names (x_m,height_m or x,height) are skipped. A file that ends
    in .gz, .bz2 or .xz is unpacked.

    Raises:
        InputError: no such file, or no such table; a height beyond +-`HIGHEST_M`.
    """
    return _of_text(read_text("terrain.file", Path(path), TABLE), Path(path))


def _of_text(text: str, file: Path) -> Terrain:
    """A height table from the text of a file of this name."""
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    lines = [line for line in lines if line]
    try:
        mark = typed.separator("\n".join(lines))
        between = None if mark == typed.BLANKS else mark
        rows = [[cell.strip() for cell in line.split(between)] for line in lines]
        if rows and tuple(rows[0]) in HEADERS:
            del rows[0]
        if mark != ",":
            pointed = iter(typed.with_points([cell for row in rows for cell in row]))
            rows = [[next(pointed) for _ in row] for row in rows]
        table = np.array(rows, dtype=np.float64, ndmin=2)
    except ValueError as error:
        raise InputError("terrain.file", str(file), f"{TABLE} ({error})") from None
    if table.shape[0] < 2 or table.shape[1] != 2:
        raise InputError(
            "terrain.file", str(file), "at least two rows of two columns x_m,height_m"
        )
    if not np.all(np.isfinite(table)) or not np.all(np.diff(table[:, 0]) > 0):
        raise InputError(
            "terrain.file", str(file), "finite numbers, x strictly increasing"
        )
    return Terrain(f"file {file.name}", np.interp(GRID_X_M, table[:, 0], table[:, 1]))


def _from_option(file: str, heights: str = "") -> Terrain:
    """`from_file` of a configuration; `heights` is the text of a file that was read."""
    return _of_text(heights, Path(file)) if heights else from_file(file)


KINDS: dict[str, Callable[..., Terrain]] = {
    "flat": flat,
    "rough": rough,
    "blocks": blocks,
    "ramp": ramp,
    "stairs": stairs,
    "file": _from_option,
}


@dataclass(frozen=True)
class Ground:
    """A kind of terrain and its options: all of a ground but the seed. It pickles and hashes.

    Attributes:
        kind: a key of `KINDS`.
        options: arguments of that kind's function. An option that is missing has its
            default; of a pair, lowest and highest, each seed draws its own.

    Raises:
        InputError: an unknown kind.
    """

    kind: str = "flat"
    options: Mapping[str, float | str | list[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        options = checks.by_name(checks.anything)
        checks.check_fields(self, "terrain.", kind=checks.word(*KINDS), options=options)

    def __hash__(self) -> int:
        pairs = {k: tuple(v) for k, v in self.options.items() if isinstance(v, list)}
        return hash((self.kind, frozenset({**self.options, **pairs}.items())))

    def draw(self, seed: int | np.random.SeedSequence) -> Terrain:
        """The terrain of this seed; kinds without randomness give the same for all.

        Raises:
            InputError: an option that the ground cannot be made with, or a file that is
                no table.
        """
        make: Callable[..., Terrain] = KINDS[self.kind]
        drawn: dict[str, Any] = (
            {"seed": seed} if "seed" in signature(make).parameters else {}
        )
        for name, value in self.options.items():
            drawn[name] = (
                _drawn(seed, name, *value) if isinstance(value, list) else value
            )
        return make(**drawn)


def read_ground(table: Table) -> Ground:
    """The table [terrain] of a configuration: its kind, and options of that kind. Reads every key.

    The text of a file, whose name starts from the configuration's folder, becomes an
    option: the options alone make the ground again.

    An option that is a number may be a pair, lowest and highest: each ground draws its
    own. Grounds of both ends are drawn here, so that options which do not fit each
    other, or a file that cannot be read, are refused before anything is computed.

    Raises:
        InputError: an unknown kind or option, a wrong type or a value out of range.
    """
    kind = table.text("kind", "flat", tuple(KINDS))
    make = KINDS[kind]
    written = table.unread
    hints = get_type_hints(make, include_extras=True)
    for name, parameter in signature(make).parameters.items():
        default: Any = (
            REQUIRED if parameter.default is Parameter.empty else parameter.default
        )
        if name == "seed":
            continue
        if get_origin(hints[name]) is not Annotated:  # a Literal's words, or any text
            table.text(name, default, get_args(hints[name]))
            continue
        _number, allowed = get_args(hints[name])
        if isinstance(written.get(name), list):
            table.range(name, (default, default), allowed.low, allowed.high)
        else:
            table.number(name, default, allowed.low, allowed.high)
    table.done()
    if table.mistaken():
        return Ground()
    if kind == "file" and not written.get("heights"):
        file = table.folder / written["file"]
        # Of an empty file, too, it is a text: without one, a file would be read.
        written["heights"] = read_text("terrain.file", file, TABLE) or "\n"
    for end in range(2):
        options = {
            name: v[end] if isinstance(v, list) else v for name, v in written.items()
        }
        Ground(kind, options).draw(seed=0)
    return Ground(kind, written)


def _drawn(
    seed: int | np.random.SeedSequence, option: str, low: float, high: float
) -> float:
    """An option of this seed's ground; another option that is drawn would not change it."""
    sequence = (
        seed
        if isinstance(seed, np.random.SeedSequence)
        else np.random.SeedSequence(seed)
    )
    key = (*sequence.spawn_key, crc32(option.encode()))
    rng = np.random.default_rng(np.random.SeedSequence(sequence.entropy, spawn_key=key))
    return float(rng.uniform(low, high))


def _random_walk(
    seed: int | np.random.SeedSequence,
    amplitude_m: float,
    spacing_m: float,
    flat_start_m: float,
    slope: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Knots from the end of the flat start on: positions and heights, [k] and [k]."""
    count = int(np.ceil((GRID_END_M - flat_start_m) / spacing_m)) + 1
    rng = np.random.default_rng(seed)
    steps = rng.uniform(-amplitude_m, amplitude_m, count - 1)
    knots_x = flat_start_m + spacing_m * np.arange(count, dtype=np.float64)
    return knots_x, np.concatenate([[0.0], np.cumsum(steps + slope * spacing_m)])


def _rising(slope: float) -> str:
    return f", rising {100 * slope:g} %" if slope else ""


def _sign(direction: Direction) -> float:
    return 1.0 if direction == "up" else -1.0
