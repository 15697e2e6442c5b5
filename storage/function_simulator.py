"""A function of one's own as the simulator of a store: candidates walked in worlds that differ.

docs/own-simulator.md has an example. `make_store` fills a store of it, as does
`taichi-nmm precompute` for a configuration with `simulator = "my_robot.py:robot"`, to
the same bytes. A table [world] says where the world of the base setting differs from
`worlds`, and [families.NAME.world] gives each number of a family's worlds, or a range
that it is drawn from.
"""

import ast
import hashlib
import inspect
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    IntDistribution,
    distribution_to_json,
)

from storage.inputs import checks
from storage.inputs.config import Table
from storage.inputs.errors import InputError, in_a_line, listed
from storage.points import within_bounds
from storage.simulator import FAILED, HORIZON_S, SURVIVED, Report, Simulator, Uniform

ENDED = "run_ended"
RAN = "ran"
SEED = "seed"  # of a world, for what a run draws, such as noise
LARGEST_SEED = 2**31

NAME = checks.that(
    lambda value: isinstance(value, str) and value.isidentifier(),
    "a name of letters, digits and '_', which begins with no digit",
)

# whose version is not that of a user's function
OURS = ("storage", "study", "taichi_nmm")
IMPORTS = (ast.Import, ast.ImportFrom)

CANARY_POINTS = 4  # of two runs each, which have to agree
CANARY_S = 1.0  # at most, unless all fail: steps of the simulator may be longer

DrawnNumbers = dict[str, NDArray[np.float64]]
"""Worlds: each number by its name, [w]."""


@dataclass(frozen=True)
class NumberRanges:
    """The rule of a table [world]: each number is drawn uniformly from its range.

    Attributes:
        ranges: lowest and highest of each number, by its name.
    """

    ranges: dict[str, tuple[float, float]]

    def draw(self, seeds: Sequence[np.random.SeedSequence]) -> DrawnNumbers:
        """One world a seed; each also has a whole number `seed` of its own."""
        low, high = np.array(list(self.ranges.values())).reshape(-1, 2).T
        generators = [np.random.default_rng(seed) for seed in seeds]
        own = np.array([float(each.integers(LARGEST_SEED)) for each in generators])
        drawn = np.array(
            [low + (high - low) * each.random(len(low)) for each in generators]
        )
        return dict(zip(self.ranges, drawn.T, strict=True)) | {SEED: own}

    def document(self, worlds: DrawnNumbers) -> dict[str, Any]:
        """The ranges, and the numbers that were drawn from them."""
        drawn = {name: values.tolist() for name, values in worlds.items()}
        return {
            "world": {name: list(ends) for name, ends in self.ranges.items()},
            "drawn": drawn,
        }


class FunctionSimulator(Simulator):
    """A function that runs a point in a world. It pickles, if the function is one of a module.

    A run that raises, or that returns NaN or infinity, has zeros in all columns and
    "failed" in the column `run_ended`; it stops no other run. A function that raises at
    each of a few points (`canary`) is refused before the work, by a line with the
    error.
    """

    columns: np.dtype[np.void] = np.dtype([])
    parameters: tuple[Uniform, ...] = ()
    measures: Mapping[str, tuple[float, float]] = MappingProxyType({})

    @checks.checked(
        function=checks.function,
        parameters=checks.by_name(checks.instance(BaseDistribution)),
        columns=checks.each(NAME),
        worlds=checks.optional(checks.by_name(checks.number())),
        measures=checks.optional(checks.by_name(checks.interval())),
        batch=checks.flag,
        longest_run_s=checks.optional(checks.number(1e-3)),
    )
    def __init__(
        self,
        function: Callable[..., Any],
        *,
        parameters: Mapping[str, BaseDistribution],
        columns: Sequence[str],
        worlds: Mapping[str, float] | None = None,
        measures: Mapping[str, tuple[float, float]] | None = None,
        batch: bool = False,
        longest_run_s: float | None = None,
    ) -> None:
        """Checked at once; nothing runs yet.

        Args:
            function: `function(point, world, seconds)` returns the columns of a run by
                their names. `point` and `world` are dicts of values by name; a world
                also has a whole number `seed`, for what the run draws. Its result
                depends on nothing else.
            parameters: Optuna's distributions by name.
            columns: names of the numbers that a run returns; "survived_fraction", from
                0 to 1, is among them and says how far the run came.
            worlds: numbers by which worlds differ, with their values in the base
                setting.
            measures: columns that tell candidates apart, with the ranges that a search
                covers.
            batch: the function takes many runs at a time: `point` has arrays [n, 1],
                `world` arrays [1, w], and columns are arrays that broadcast to [n, w].
            longest_run_s: of one run: one that hangs is stopped and has failed. Choose
                far more than any run takes. It stops Python alone, in processes of this
                machine.

        Raises:
            InputError: a function that other processes cannot import, a name that is
                none.
        """
        self._source = source_of(function)
        self._failed = ""  # the last run that raised
        self._horizon_s = HORIZON_S  # of the store's base setting, or of a trial
        self.function, self.batch, self.space = function, batch, dict(parameters)
        self.worlds = {name: float(value) for name, value in (worlds or {}).items()}
        self.measures = dict(measures or {})
        if not self.space:
            raise InputError("parameters", "none", "one distribution at least")
        if ENDED in columns:
            allowed = "other names: this column says whether a run failed"
            raise InputError("columns", ENDED, allowed)
        if SURVIVED not in columns or len({*columns}) < len(columns):
            raise InputError(
                "columns", list(columns), f"{SURVIVED} among them, and each name once"
            )
        if batch and longest_run_s is not None:
            raise InputError("longest_run_s", longest_run_s, "none with batch=True")
        self.longest_run_s = longest_run_s
        if SEED in self.worlds:
            raise InputError(
                "worlds", SEED, "another name: each world has a seed of its own"
            )
        for name in (*self.space, *self.worlds):
            NAME("parameters" if name in self.space else "worlds", name)
        self.parameters = tuple(
            _coordinate(name, each) for name, each in self.space.items()
        )
        self.columns = np.dtype([*((name, "f8") for name in columns), (ENDED, "u1")])

    @property
    def name(self) -> str:
        """The file's name without its ending, and the function's."""
        return f"{self._source.stem}:{self.function.__qualname__}"

    @property
    def code_version(self) -> str:
        """A digest of `code_of` the function: a store is of one version of it."""
        return hashlib.sha256(code_of(self.function)).hexdigest()[:16]

    @property
    def words(self) -> Mapping[str, Sequence[str]]:
        """Whether a run ended as it should."""
        return {ENDED: (RAN, FAILED)}

    def read(self, table: Table, arch: str | None) -> "FunctionSimulator":  # type: ignore[override]
        """Itself: a configuration has no settings for it."""
        if arch is not None:
            raise InputError("arch", arch, f"no architecture: {self.name} reads none")
        return self

    def document(self) -> dict[str, Any]:
        """What the base setting's world is, where a table does not say another."""
        return {
            "worlds": self.worlds,
            "measures": {k: list(v) for k, v in self.measures.items()},
        }

    def read_worlds(self, table: Table) -> NumberRanges:
        """The table [world]: numbers, and ranges [lowest, highest]; others are as in `worlds`."""
        own, ranges = table.table("world"), {}
        for name, usual in self.worlds.items():
            if isinstance(own.unread.get(name), list):
                ranges[name] = own.range(name, (usual, usual), -np.inf, np.inf)
            else:
                ranges[name] = (own.number(name, usual),) * 2
        own.done()
        return NumberRanges(ranges)

    def run(
        self,
        points: NDArray[np.float64],
        worlds: DrawnNumbers,
        horizon_s: float,
        report: Report,
    ) -> tuple[NDArray[np.void], dict[str, Any]]:
        """Run every point in every world, [n, w].

        Args:
            points: [n, p]; a choice is its number.
            worlds: w of them, each number by its name, [w].
            horizon_s: after which a run is over.
            report: called with the fraction that is done, 0 to 1.
        """
        count = len(worlds[SEED])
        rows = np.zeros((len(points), count), self.columns)
        values = [self._values(name, points[:, k]) for k, name in enumerate(self.space)]
        if self.batch:
            pairs = zip(self.space, values, strict=True)
            named = {name: self._array(name, each)[:, None] for name, each in pairs}
            whole = {name: each[None, :] for name, each in worlds.items()}
            try:
                found = self._compute(named, whole, horizon_s)
            except InputError:
                raise
            except Exception as error:
                raise self._fault(
                    f"a function that runs, not {in_a_line(error)}"
                ) from error
            self._keep(rows, found)
            return rows, {}
        for place in np.ndindex(rows.shape):
            point = {
                name: each[place[0]]
                for name, each in zip(self.space, values, strict=True)
            }
            world = {name: each[place[1]].item() for name, each in worlds.items()}
            world[SEED] = int(world[SEED])
            try:
                with _limited(self.longest_run_s):
                    found = self._compute(point, world, horizon_s)
            except Exception as error:
                rows[ENDED][place] = 1
                self._failed = f"{in_a_line(error)}, at {point} in {world}"
            else:
                self._keep(
                    rows[place[0] : place[0] + 1, place[1] : place[1] + 1], found
                )
            report((place[0] + 1) / len(points))
        return rows, {}

    def _compute(
        self, point: Any, world: Mapping[str, Any], seconds: float
    ) -> Mapping[str, Any]:
        """Columns of one run, or with `batch` of all [n, w]: what the function returns."""
        found: Mapping[str, Any] = self.function(point, world, seconds)
        return found

    def _values(self, name: str, column: NDArray[np.float64]) -> Sequence[Any]:
        """A parameter's values as its distribution has them, [n]."""
        distribution = self.space[name]
        if isinstance(distribution, CategoricalDistribution):
            return [distribution.choices[int(index)] for index in column]
        whole = isinstance(distribution, IntDistribution)
        return list(column.astype(np.int64).tolist() if whole else column.tolist())

    def _array(self, name: str, values: Sequence[Any]) -> NDArray[Any]:
        """Values of a parameter as an array, [n], whose type no other run decides.

        NumPy would turn choices such as 1 and "fast" into words.
        """
        distribution = self.space[name]
        if not isinstance(distribution, CategoricalDistribution):
            return np.asarray(values)
        kind = np.asarray(distribution.choices).dtype
        is_of_words = all(isinstance(choice, str) for choice in distribution.choices)
        return np.array(
            values, dtype=object if kind.kind == "U" and not is_of_words else kind
        )

    def _keep(self, rows: NDArray[np.void], found: Mapping[str, Any]) -> None:
        """Write what the function returned into rows [n, w] of zeros."""
        names = [name for name in self.columns.names or () if name != ENDED]
        if not isinstance(found, Mapping) or set(found) != set(names):
            wrong = list(found) if isinstance(found, Mapping) else type(found).__name__
            raise self._fault(
                f"a function that returns {listed(names)} by name, not {wrong}"
            )
        for name in names:
            try:
                rows[name] = np.broadcast_to(
                    checks.numbers(name, found[name]), rows.shape
                )
            except ValueError:  # of the shape; an `InputError` is one, too
                shape = list(rows.shape)
                raise self._fault(
                    f"{name} as numbers that broadcast to {shape}"
                ) from None
        whole = np.all([np.isfinite(rows[name]) for name in names], axis=0)
        for name in names:
            rows[name][~whole] = 0.0
        rows[ENDED] = ~whole

    def lasting(self, horizon_s: float) -> Self:
        """The same, whose canary takes so long where a second is too short."""
        same = copy(self)
        same._horizon_s = horizon_s
        return same

    def canary(self) -> NDArray[np.void]:
        """A few points in the base setting's world, by whose bits machines are told apart."""
        return self._canary(CANARY_POINTS, self._canary_s())

    def _canary_s(self) -> float:
        """How long the canary's runs are: as the store's where shorter ones all fail."""
        seconds = min(CANARY_S, self._horizon_s)
        try:
            failed = self._canary(CANARY_POINTS, seconds)[ENDED] == 1
        except InputError:  # of a function of many runs at a time
            return self._horizon_s
        return self._horizon_s if failed.all() else seconds

    def _canary(self, count: int, seconds: float) -> NDArray[np.void]:
        """The first points of the canary."""
        unit = (np.arange(CANARY_POINTS)[:, None] + 0.5) / CANARY_POINTS
        points = within_bounds(
            np.tile(unit, (1, len(self.parameters))), self.parameters
        )
        worlds = self.read_worlds(Table({})).draw([np.random.SeedSequence(0)])
        return self.run(points[:count], worlds, seconds, lambda part: None)[0]

    def require_machine(self) -> None:
        """Refuse a function that raises at all points of the canary, or does not repeat itself."""
        seconds = self._canary_s()
        rows = self._canary(CANARY_POINTS, seconds)
        if self._failed and np.all(rows[ENDED] == 1):
            raise self._fault(f"a function that runs, not {self._failed}")
        if rows.tobytes() != self._canary(CANARY_POINTS, seconds).tobytes():
            allowed = f"a function whose runs repeat; draw random numbers from world[{SEED!r}]"
            raise self._fault(allowed)
        if self.batch and rows[:1].tobytes() != self._canary(1, seconds).tobytes():
            raise self._fault(
                "a function whose runs do not depend on others of the same call"
            )

    def _fault(self, allowed: str) -> InputError:
        return InputError("simulator", self.name, allowed)


@contextmanager
def _limited(seconds: float | None) -> Iterator[None]:
    """Raise a `TimeoutError` in the midst of Python code that takes longer; None: never."""
    if seconds is None or threading.current_thread() is not threading.main_thread():
        yield  # a thread of a Dask worker gets no signals
        return

    def stop(*_: object) -> None:
        raise TimeoutError(f"longer than longest_run_s, {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _coordinate(name: str, distribution: BaseDistribution) -> Uniform:
    """A parameter as a coordinate of points; a choice is its number."""
    if isinstance(distribution, CategoricalDistribution):
        last, log, step = len(distribution.choices) - 1, False, 1.0
        low, high = 0.0, float(last)
    else:
        low, high = float(distribution.low), float(distribution.high)  # type: ignore[attr-defined]
        log = bool(distribution.log)  # type: ignore[attr-defined]
        step = float(distribution.step or 0.0)  # type: ignore[attr-defined]
    own = distribution_to_json(distribution) if log or step else ""
    return Uniform(name, low, high, log, step, own)


def source_of(function: Callable[..., Any]) -> Path:
    """The file of a function that other processes can import."""
    allowed = "a function of a module or of a file, which other processes can import"
    try:
        file = inspect.getsourcefile(function)
    except TypeError:
        raise InputError("function", type(function).__name__, allowed) from None
    if file is None or not Path(file).is_file() or "<" in function.__qualname__:
        raise InputError("function", function.__qualname__, allowed)
    return Path(file)


def code_of(function: Callable[..., Any]) -> bytes:
    """The content of a function's file, and of the files of its folder that this one imports.

    These are found by the import statements, wherever they stand, and those of the
    files found.
    """
    files = [source_of(function).resolve()]
    for file in files:  # which grows
        try:
            tree = ast.parse(file.read_bytes())
        except SyntaxError:  # of a file that nothing can import
            continue
        for node in ast.walk(tree):
            for name in _imported(node):
                path = file.parent.joinpath(*name.split("."))
                for found in (path.with_suffix(".py"), path / "__init__.py"):
                    if found.is_file() and found not in files:
                        files.append(found)
    return b"".join(file.read_bytes() for file in files)


def _imported(node: ast.AST) -> list[str]:
    """Modules that a statement may name, as seen from its folder; not those of this project."""
    named = [alias.name for alias in node.names] if isinstance(node, IMPORTS) else []
    if isinstance(node, ast.ImportFrom) and node.module:
        named = [node.module, *(f"{node.module}.{name}" for name in named)]
    return [name for name in named if name.partition(".")[0] not in OURS]
