"""The seam: all that a store knows of the simulator whose scores it keeps.

A simulator has parameters, a rule that draws worlds from seeds, and `run`, which gives
a row of columns for every point in every world. Nothing else in this package depends on
what is simulated. CONTRIBUTING.md has a class of one's own, with all that has no
default. A class that has every member, such as the walker, need not be a child of
`Simulator`. A plain function is enough, too: `storage.function_simulator`.
"""

import sys
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from storage.inputs import checks
from storage.inputs.config import Table
from storage.inputs.errors import InputError, listed, one_line, shortened

WALKER = "walker"
# imported when a store needs one
SIMULATORS = {WALKER: "taichi_nmm.walker_simulator:Walker"}
# of a specification; stores of the walker are older and lack it
SIMULATOR_KEY = "simulator"
# Of a specification: the parameters. The first stores were of the walker alone, and all
# newer ones have its word, so that any version reads them.
PARAMETERS_KEY = "gains"
SURVIVED = "survived_fraction"
FAILED = "failed"  # among the words of a column: the run gave no numbers, and has zeros

HORIZON_S = 5.0  # of the base setting, where the configuration names none
ROUNDING = 1e-6  # of the horizon; adding up the steps of a run loses less

Report = Callable[[float], None]
"""Called with the fraction of the work that is done."""

Worlds = Any
"""Worlds that a rule has drawn, of any type that pickles."""


class Parameter(Protocol):
    """A coordinate of a point; a store draws it uniformly from `low` to `high`."""

    @property
    def name(self) -> str:
        """Name of its column, with the unit."""

    @property
    def low(self) -> float:
        """Lower bound."""

    @property
    def high(self) -> float:
        """Upper bound, above the lower one."""


class Uniform(NamedTuple):
    """A `Parameter` of one's own.

    Attributes:
        name: of its column, with the unit.
        low: lower bound, in this unit.
        high: upper bound, above the lower one.
        log: whether the logarithm is drawn uniformly; `low` is positive then.
        step: values are `low` and so many steps; 0: any value from `low` to `high`.
        distribution: Optuna's, as its JSON text; "": a float from `low` to `high`.
    """

    name: str
    low: float
    high: float
    log: bool = False
    step: float = 0.0
    distribution: str = ""


class WorldRule(Protocol):
    """Draws worlds, such as grounds of one kind with random options."""

    def draw(self, seeds: Sequence[np.random.SeedSequence]) -> Worlds:
        """One world a seed; each depends on its own seed alone."""

    def document(self, worlds: Worlds) -> dict[str, Any]:
        """The rule, and the worlds that it has drawn, as JSON values."""


class Simulator(Protocol):
    """A simulator with its settings. It pickles: any process runs points with it."""

    @property
    @abstractmethod
    def code_version(self) -> str:
        """Version of the code that computes; a store is of one version."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Coordinates of a point, [p]."""

    @property
    @abstractmethod
    def columns(self) -> np.dtype[np.void]:
        """Names and types of the numbers that a run gives, units in the names."""

    @abstractmethod
    def read_worlds(self, table: Table) -> WorldRule:
        """The rule in the table of a family, or in the whole configuration for the base setting.

        Raises:
            InputError: a value out of range.
        """

    @abstractmethod
    def run(
        self,
        points: NDArray[np.float64],
        worlds: Worlds,
        horizon_s: float,
        report: Report,
    ) -> tuple[NDArray[np.void], dict[str, Any]]:
        """Run every point in every world.

        Args:
            points: [n, p], in units of the parameters.
            worlds: w of them, as a rule of `read_worlds` has drawn them.
            horizon_s: after which a run is over.
            report: to be called with the fraction that is done, now and then or never.

        Returns:
            Rows of `columns`, [n, w], each of which depends on its point, its world and
                the horizon
            alone; and what computed them, such as versions of libraries, as JSON
                values.
        """

    @property
    def name(self) -> str:
        """Name in specifications. Default: module and class, as a configuration names them."""
        return f"{type(self).__module__}:{type(self).__qualname__}"

    @property
    def survived(self) -> str:
        """Column that tells how far a run came: its share of the horizon, from 0 to 1."""
        return SURVIVED

    @property
    def words(self) -> Mapping[str, Sequence[str]]:
        """Columns that a store keeps as words, with the words that their numbers count from 0.

        A run with the word "failed" has zeros for the numbers that it did not give.
        """
        return {}

    @property
    def scores(self) -> tuple[str, ...]:
        """Columns of which a store keeps mean and spread over the worlds of a family.

        They are finite, and `survived` is among them. Default: all columns but those of
        words.
        """
        return tuple(
            name for name in self.columns.names or () if name not in self.words
        )

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Columns of which a store keeps what each world of a family gave, `survived` first.

        A configuration names others as `kept`. Default: all scores.
        """
        others = [name for name in self.scores if name != self.survived]
        return (self.survived, *others)

    @property
    def outcome_type(self) -> type[np.floating[Any]]:
        """The numbers that keep `outcomes`. Default: float64, which changes none."""
        return np.float64

    @classmethod
    def read(cls, table: Table, arch: str | None) -> Self:
        """The simulator that a configuration describes. Default: one without settings.

        Args:
            table: the whole configuration; a key that is not read is refused. The table
                [simulator] is for the simulator's own settings; of [simulation],
                `duration_s` is the store's.
            arch: hardware that computes, where the command line names it.

        Raises:
            InputError: a value out of range.
        """
        if arch is not None:
            raise InputError(
                "arch", arch, f"no architecture: {cls.__name__} reads none"
            )
        return cls()

    def document(self) -> dict[str, Any]:
        """All settings that decide results, as JSON values. Default: the fields of a dataclass.

        Keys of a table "simulation" join the store's own.
        """
        names: list[str] = (
            [each.name for each in fields(self)] if is_dataclass(self) else []
        )
        return (
            {"settings": {name: getattr(self, name) for name in names}} if names else {}
        )

    def versions(self) -> dict[str, str]:
        """Versions that a specification names beside `code_version`, by key.

        Raises:
            InputError: something is not installed.
        """
        return {}

    @classmethod
    def parameters_of(cls, names: Sequence[str]) -> tuple[Parameter, ...]:
        """The parameters of a store whose points have parameters of these names."""
        return tuple(cls.parameters)  # type: ignore[arg-type]  # where the class has them

    @property
    def measures(self) -> Mapping[str, tuple[float, float]]:
        """Columns that tell candidates apart, with the ranges that a search covers.

        Default: none, and a store cannot have a search.
        """
        return {}

    @property
    def objective(self) -> str:
        """Name of the number that a search for candidates maximises."""
        return "objective"

    def judge(
        self, rows: NDArray[np.void], horizon_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Objective [n] and measures [n, m] of n points, for a search.

        Default: means over the worlds, of `survived` and of the columns of `measures`.

        Args:
            rows: of the points in w worlds, [n, w].
            horizon_s: of these runs.
        """
        means = [rows[name].astype(np.float64).mean(axis=1) for name in self.measures]
        return rows[self.survived].astype(np.float64).mean(axis=1), np.column_stack(
            means
        )

    @property
    def packages(self) -> tuple[str, ...]:
        """Installed packages whose versions decide results."""
        return ("numpy",)

    def lasting(self, horizon_s: float) -> Self:
        """The same for runs of about so long, which a check before the work takes, too.

        Args:
            horizon_s: of the runs.
        """
        return self

    def canary(self) -> NDArray[np.void]:
        """Rows of a small fixed batch, by whose bits machines are told apart. Default: none."""
        return np.zeros(0, self.columns)

    def on_one_thread(self) -> Self:
        """The same for one of several processes of a machine; no result depends on it."""
        return self

    @property
    def points_at_once(self) -> int:
        """Points of a call of `run` that make full use of the machine; 0: a shard's."""
        return 0

    def require_machine(self) -> None:
        """Refuse a machine on which the simulator cannot run; nothing is written.

        Raises:
            InputError: naming what is missing.
        """
        return None

    def processes(self, cores: int) -> int:
        """How many processes of a machine with so many cores should work side by side."""
        return cores


def find_simulator(name: str, folder: Path = Path()) -> type[Simulator]:
    """The simulator of this name, or "module:Class", or "file.py:Class" of a folder.

    The module is an installed one or, where there is none, a file of the working
    directory. A `FunctionSimulator` has the place of a class.

    Raises:
        InputError: there is none, or a class that is no simulator.
    """
    allowed = (
        f"{' or '.join(SIMULATORS)}, or a class that can be imported: module:Class"
    )
    field, path = f"{SIMULATOR_KEY}.name", SIMULATORS.get(name, name)
    found: type[Simulator] = import_object(field, path, folder, allowed)
    if missing := _missing(found):
        raise InputError(field, name, f"a class that has {', '.join(missing)}, too")
    return found


def import_object(field: str, name: str, folder: Path, allowed: str) -> Any:
    """The object "module:name", or "file.py:name" of a folder; else an error of the field."""
    module, _, attribute = name.partition(":")
    if not attribute:
        raise InputError(field, name, allowed)
    where, file = Path.cwd(), None
    if module.endswith(".py"):
        file = (folder / module).resolve()
        where, module = file.parent, file.stem
    if str(where) not in sys.path:
        # last, so that it hides nothing; processes that start take it over
        sys.path.append(str(where))
    try:
        imported = import_module(module)
        found = getattr(imported, attribute)
    except InputError:
        raise
    except Exception as error:  # the file is a user's: it may raise anything
        reason = one_line(shortened(f"{error}" or type(error).__name__))
        raise InputError(field, name, f"{allowed} ({reason})") from None
    taken = Path(str(imported.__file__)).resolve()
    if file not in (None, taken):
        raise InputError(
            field, name, f"a file whose name is not that of another module ({taken})"
        )
    return found


def _missing(found: Any) -> list[str]:
    """Members of a simulator that a class or an object lacks."""
    missing = {each for each in vars(Simulator) if not each.startswith("_")} - set(
        dir(found)
    )
    return sorted(missing | getattr(found, "__abstractmethods__", frozenset()))


a_simulator = checks.that(
    lambda value: not isinstance(value, type) and not _missing(value),
    "a simulator, such as a FunctionSimulator",
)


def known_simulator(specification: Mapping[str, Any]) -> type[Simulator]:
    """The simulator of a store that was read; no file can have other code imported.

    Raises:
        InputError: the store is of a simulator that is not one of `SIMULATORS`.
    """
    name = specification.get(SIMULATOR_KEY, WALKER)
    if name not in SIMULATORS:
        raise InputError(f"store.{SIMULATOR_KEY}", name, " or ".join(SIMULATORS))
    return find_simulator(name)


def check_simulator(simulator: Simulator) -> None:
    """Refuse parameters and columns that make no store.

    Raises:
        InputError: naming the simulator and what is wrong.
    """
    names, survived = simulator.columns.names or (), simulator.survived
    if survived not in names:
        raise _fault(simulator, f"columns with {survived}, how far a run came")
    if survived not in simulator.scores:
        raise _fault(simulator, f"{survived} among the scores")
    if simulator.outcomes[:1] != (survived,):
        raise _fault(simulator, f"outcomes with {survived} first")
    for kind in ("scores", "words", "measures", "outcomes"):
        for name in getattr(simulator, kind):
            if name not in names:
                raise _fault(simulator, f"{kind} that are columns; {name!r} is none")
    for name in simulator.scores:
        if name in simulator.words or simulator.columns[name].kind not in "fiu":
            raise _fault(simulator, f"scores that are numbers; {name!r} is none")
    if not simulator.parameters:
        raise _fault(simulator, "one parameter at least")
    for each in simulator.parameters:
        _check_parameter(simulator, each)
    every = ["row", *(each.name for each in simulator.parameters), *names]
    for name in every:
        if every.count(name) > 1:
            allowed = (
                "other names than 'row' for parameters and columns, each once, not "
            )
            raise _fault(simulator, f"{allowed}{name!r}")


def _check_parameter(simulator: Simulator, parameter: Parameter) -> None:
    """Refuse bounds between which no value can be drawn."""
    name = checks.text(f"{SIMULATOR_KEY}.parameters", parameter.name)
    a_number = checks.that(checks.is_number, "a number")
    low = a_number(f"{name}.low", parameter.low)
    high = a_number(f"{name}.high", parameter.high)
    if not (np.isfinite([low, high]).all() and low < high):
        allowed = f"parameters with low < high; {name} has {low}, {high}"
        raise _fault(simulator, allowed)
    if isinstance(parameter, Uniform):
        checks.flag(f"{name}.log", parameter.log)
        checks.number(0.0, high - low)(f"{name}.step", parameter.step)
        if parameter.log and low <= 0.0:
            raise _fault(simulator, f"a logarithmic {name} from above 0, not {low}")


def run_points(
    simulator: Simulator,
    points: NDArray[np.float64],
    worlds: Worlds,
    count: int,
    horizon_s: float,
    report: Report = lambda part: None,
) -> tuple[NDArray[np.void], dict[str, Any]]:
    """`Simulator.run`, and a check of what it returns.

    Args:
        simulator: that runs the points.
        points: [n, p], in units of the parameters.
        worlds: that a rule has drawn.
        count: of these worlds, w.
        horizon_s: after which a run is over.
        report: called with the fraction that is done, 0 to 1.

    Raises:
        InputError: a simulator that does not keep what `Simulator` promises, naming the
            column.
    """
    rows, computed_by = simulator.run(points, worlds, horizon_s, report)
    if not isinstance(rows, np.ndarray) or rows.dtype != simulator.columns:
        wrong = (
            rows.dtype.names or rows.dtype
            if isinstance(rows, np.ndarray)
            else type(rows)
        )
        names = listed(simulator.columns.names or ())
        raise _fault(
            simulator, f"a run with columns {names} of their types, not {wrong}"
        )
    if rows.shape != (len(points), count):
        shape = f"[{len(points)} points, {count} worlds]"
        raise _fault(simulator, f"a run with rows {shape}, not {list(rows.shape)}")
    for name in simulator.scores:
        if not np.isfinite(rows[name]).all():
            raise _fault(simulator, f"a run with finite {name}, not NaN or infinity")
    lasted = rows[simulator.survived]
    rounded = (np.abs(lasted - 1.0) <= ROUNDING) & (lasted != 1.0)
    if rounded.any():  # else runs that lasted would count as runs that did not
        rows = rows.copy()
        lasted = rows[simulator.survived]
        lasted[rounded] = 1.0
    for outside in lasted[~((lasted >= 0.0) & (lasted <= 1.0))]:
        raise _fault(
            simulator, f"a run with {simulator.survived} from 0 to 1, not {outside:g}"
        )
    for name, words in simulator.words.items():
        for outside in rows[name][~((rows[name] >= 0) & (rows[name] < len(words)))]:
            raise _fault(
                simulator,
                f"a run with {name} from 0 to {len(words) - 1}, not {outside}",
            )
    return rows, computed_by


def failed_runs(simulator: Simulator, rows: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which of some runs [...] gave no numbers, as a column of words says."""
    failed = np.zeros(rows.shape, dtype=bool)
    for name, words in simulator.words.items():
        if FAILED in words:
            failed |= rows[name] == words.index(FAILED)
    return failed


def judge_rows(
    simulator: Simulator, rows: NDArray[np.void], horizon_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`Simulator.judge`, and a check of what it returns.

    Args:
        simulator: that judges.
        rows: of n points in w worlds, [n, w].
        horizon_s: of these runs.

    Raises:
        InputError: an objective or measures that are not finite or of another shape.
    """
    objective, measures = simulator.judge(rows, horizon_s)
    shapes = (len(rows),), (len(rows), len(simulator.measures))
    finite = np.isfinite(objective).all() and np.isfinite(measures).all()
    if not finite or (np.shape(objective), np.shape(measures)) != shapes:
        allowed = (
            f"an objective {list(shapes[0])} and measures {list(shapes[1])}, all finite"
        )
        raise _fault(simulator, allowed)
    return objective, measures


def _fault(simulator: Simulator, allowed: str) -> InputError:
    return InputError(SIMULATOR_KEY, simulator.name, allowed)
