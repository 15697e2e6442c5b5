"""The specification of a store: everything that decides its numbers, and nothing else.

Points of a simulator's parameters are run in one world, the *base setting*. Those that
last are run in the worlds of *families*; a *repertoire* adds candidates that a search
bred for families. Architecture and threads are no part of it, so another machine can
finish a store.
"""

import json
import re
from collections.abc import Set
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any
from zlib import crc32

import numpy as np
import pyarrow as pa

from storage import points
from storage.inputs import checks
from storage.inputs.config import REQUIRED, Table
from storage.inputs.errors import InputError, listed
from storage.layout import Layout
from storage.points import LARGEST_SEQUENCE, seed_sequence
from storage.simulator import (
    HORIZON_S,
    PARAMETERS_KEY,
    SIMULATOR_KEY,
    WALKER,
    Parameter,
    Simulator,
    WorldRule,
    Worlds,
    check_simulator,
    find_simulator,
)
from storage.store import ORIGIN, Store, arrow_schema, columns_of
from storage.tables import FORMAT, document_hash

HORIZONS_S = 1e-9, 1e12  # shortest and longest run: of a circuit, of a forest
WALKS_S = 0.1, 1000.0  # of the walker
# The walker's defaults for families; of other simulators they are shares.
LEAST_WALK_S, LEAST_LASTED_S = 8.0, 3.0
# Of the base setting's horizon, that a family's points have lasted by default.
LEAST_SHARE = 0.6
SHARD_ROWS = 4096  # seconds of work on two cores, and a few MB

ROBUST = "robust"  # the family that has a table of its own
NAME_PATTERN = r"[a-z][a-z0-9_]*"
MOST_WORLDS = 64  # of a family
# Of a store, unless the configuration says which columns worlds keep.
MOST_OUTCOMES_B = 2**31

LIBRARY = "ribs"  # of quality-diversity optimisation
EMITTERS = 4  # evolution strategies of a search, each begun elsewhere
# Points of an emitter in a generation: twice what CMA-ES takes in 16 dimensions.
BATCH = 24
GENERATION = EMITTERS * BATCH  # points that a search tries at a time
STARTS = 2 * GENERATION  # points of the grid that a search may begin with
# Of a family, for a candidate: fewer find gaits for these worlds alone.
SEARCH_WORLDS = 8
LARGEST_NUMBER = 2**30  # of runs, or of candidates

# Keys of a specification that no simulator's document may have.
RESERVED = frozenset(
    {
        "format",
        "code_version",
        SIMULATOR_KEY,
        "samples",
        "shard_rows",
        "seed",
        PARAMETERS_KEY,
        "simulation",
        "robust",
        "families",
        "repertoire",
        "columns",
    }
)


@dataclass(frozen=True, eq=False)
class Family:
    """Worlds in which every point that lasts `min_survival_s` is run for `horizon_s`.

    A family that comes after another one is for the few that survive that: more worlds,
    longer. All points share the worlds.

    Attributes:
        name: at the beginning of its columns.
        settings: number of worlds, w.
        min_survival_s: how long a point must last in the base setting.
        after: another family that a point must have survived; "": none.
        min_survived_fraction: how much of that family's horizon, 0 to 1, on average
            over its worlds.
        horizon_s: of every run.
        seed: of the worlds.
        rule: by which worlds are drawn.
    """

    name: str
    settings: int
    min_survival_s: float
    after: str
    min_survived_fraction: float
    horizon_s: float
    seed: int
    rule: WorldRule

    @cached_property
    def worlds(self) -> Worlds:
        """Its worlds, drawn."""
        numbers = range(self.settings)
        return self.rule.draw(
            [seed_sequence(self.seed, points.FAMILY_WORLD, k) for k in numbers]
        )

    @property
    def document(self) -> dict[str, Any]:
        """The family without its name, as JSON values."""
        stage = {
            "after": self.after,
            "min_survived_fraction": self.min_survived_fraction,
        }
        own = {
            "settings": self.settings,
            "min_survival_s": self.min_survival_s,
            **(stage if self.after else {}),  # the keys are newer than many stores
            "horizon_s": self.horizon_s,
            "seed": self.seed,
        }
        return own | _other_keys(self.rule.document(self.worlds), own.keys())


@dataclass(frozen=True, eq=False)
class Repertoire:
    """A search that begins at survivors of the grid, and candidates that a store keeps of it.

    Attributes:
        evaluations: runs that the whole search may take: those of all points in
            `settings` worlds each.
        candidates: rows that the store gets.
        seed: of the search, and of the worlds that candidates are tried in.
        settings: worlds that a candidate is tried in, of the one family that it is bred
            for.
        families: that candidates are bred for; none of them comes after another.
    """

    evaluations: int
    candidates: int
    seed: int
    settings: int
    families: tuple[Family, ...]

    @cached_property
    def trials(self) -> tuple[Family, ...]:
        """The families with worlds of the search's own, [f].

        A candidate is chosen for what it does in these, and measured in the family's
        own.
        """
        streams = [
            self.stream(each.name, points.TRIAL_WORLDS) for each in self.families
        ]
        seeds = [int(stream.generate_state(1, np.uint64)[0]) for stream in streams]
        pairs = zip(self.families, seeds, strict=True)
        return tuple(
            replace(each, settings=self.settings, seed=seed) for each, seed in pairs
        )

    @property
    def generations(self) -> int:
        """Generations of all families together, after those of the grid's points."""
        tried = self.evaluations // self.settings - STARTS * len(self.families)
        return tried // GENERATION

    @property
    def walks(self) -> int:
        """Runs of the whole search; fewer than were asked for: generations are whole."""
        return (
            STARTS * len(self.families) + self.generations * GENERATION
        ) * self.settings

    def stream(
        self, family: str, purpose: int = points.EVOLUTION
    ) -> np.random.SeedSequence:
        """A random stream of the search for a family, whatever the other families are."""
        return seed_sequence(self.seed, purpose, crc32(family.encode()))

    @property
    def document(self) -> dict[str, Any]:
        """The repertoire as JSON values."""
        return {
            "evaluations": self.evaluations,
            "candidates": self.candidates,
            "seed": self.seed,
            "settings": self.settings,
            "families": {family.name: family.document for family in self.trials},
            "library": f"{LIBRARY} {library_version()}",  # another version evolves other candidates
        }


@dataclass(frozen=True, eq=False)
class Specification:
    """A store to be computed. It pickles: any process computes a shard from it.

    Attributes:
        simulator: that runs the points, with its settings.
        samples: points of the grid.
        shard_rows: points of a shard; the last may have fewer.
        seed: of the Sobol sequence, and of the world of the base setting.
        horizon_s: of the base setting.
        rule: by which the world of the base setting is drawn.
        outcomes: columns that each world of a family keeps.
        families: of worlds, for the points that last in the base setting.
        repertoire: of candidates beyond the grid; None: there are none.
    """

    simulator: Simulator
    samples: int
    shard_rows: int
    seed: int
    horizon_s: float
    rule: WorldRule
    outcomes: tuple[str, ...]
    families: tuple[Family, ...] = ()
    repertoire: Repertoire | None = None

    @cached_property
    def worlds(self) -> Worlds:
        """The one world of the base setting."""
        return self.rule.draw([seed_sequence(self.seed, points.BASE_WORLD)])

    @property
    def schema(self) -> pa.Schema:
        """The columns of every shard."""
        families = {family.name: family.settings for family in self.families}
        origin = self.repertoire is not None
        return arrow_schema(self.simulator, families, self.outcomes, origin)

    @property
    def layout(self) -> Layout:
        """Which rows are in which shard."""
        candidates = self.repertoire.candidates if self.repertoire else 0
        return Layout(self.samples, self.shard_rows, candidates)

    @property
    def work(self) -> int:
        """What progress counts: rows, and runs of the search."""
        return self.layout.rows + (self.repertoire.walks if self.repertoire else 0)

    def on_one_thread(self) -> "Specification":
        """The same for one of several processes of a machine; no number depends on it."""
        return replace(self, simulator=self.simulator.on_one_thread())

    @cached_property
    def document(self) -> dict[str, Any]:
        """The specification as JSON values, for specification.json and the footers.

        Its hash depends on the order of keys. Keys that are newer than many stores
        appear only where they are needed, so that these stores can be finished.
        """
        simulator, own = self.simulator, self.simulator.document()
        simulation = {"duration_s": self.horizon_s, **own.pop("simulation", {})}
        drawn = self.rule.document(self.worlds)
        families = {family.name: family.document for family in self.families}
        robust = families.pop(ROBUST, None)
        document = {
            "format": FORMAT,
            "code_version": simulator.code_version,
            **({} if simulator.name == WALKER else {SIMULATOR_KEY: simulator.name}),
            "samples": self.samples,
            "shard_rows": self.shard_rows,
            "seed": self.seed,
            PARAMETERS_KEY: {each.name: _ends(each) for each in simulator.parameters},
            **_other_keys(own, RESERVED),
            "simulation": simulation,
            **_other_keys(drawn, RESERVED | own.keys()),
            "robust": robust,
            **({"families": families} if families else {}),
            **simulator.versions(),
            **({"repertoire": self.repertoire.document} if self.repertoire else {}),
            "columns": columns_of(self.schema),
        }
        try:
            json.dumps(document, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError(
                SIMULATOR_KEY, simulator.name, f"JSON values ({error})"
            ) from None
        return document

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the document."""
        return document_hash(self.document)


def _ends(parameter: Parameter) -> dict[str, Any]:
    """Bounds of a parameter, and its distribution where it is another than a float's between."""
    own = getattr(parameter, "distribution", "")
    ends = {"low": float(parameter.low), "high": float(parameter.high)}
    return ends | ({"distribution": json.loads(own)} if own else {})


def require_parameters(store: Store, simulator: Simulator) -> None:
    """Refuse a store whose points mean something else to a simulator.

    Raises:
        InputError: parameters of other names or in another order, other choices, whole
            numbers in one of the two alone, or bounds beyond the simulator's.
    """
    own = {each.name: _ends(each) for each in simulator.parameters}
    stored = store.bounds
    if tuple(stored) != tuple(own):
        words = f"{simulator.name}, with the parameters {listed(own)}"
        raise InputError("store", str(store.path), f"a store of {words}")
    for name, ends in own.items():
        is_within = (
            ends["low"] <= stored[name]["low"] and stored[name]["high"] <= ends["high"]
        )
        if _kind(stored[name]) != _kind(ends) or not is_within:
            allowed = f"{ends}, as {simulator.name} has it"
            raise InputError(f"store.{PARAMETERS_KEY}.{name}", stored[name], allowed)


def _kind(ends: dict[str, Any]) -> tuple[str, Any]:
    """What numbers of a parameter stand for: the name of its distribution, and its choices."""
    distribution = ends.get(
        "distribution", {"name": "FloatDistribution", "attributes": {}}
    )
    return distribution["name"], distribution["attributes"].get("choices")


def read_specification(
    table: Table,
    samples: int | None = None,
    arch: str | None = None,
    simulator: Simulator | None = None,
) -> Specification:
    """The specification in a configuration; `samples` and `arch` override the file's.

    `simulator` stands for the one that the configuration would name.

    Raises:
        InputError: an unknown key, a wrong type or a value out of range; a family or a
            search that the others, or the simulator, do not allow.
    """
    configured = table.integer("samples", low=1, high=LARGEST_SEQUENCE)
    if samples is not None:
        checks.whole(1, LARGEST_SEQUENCE)("samples", samples)
    seed = table.integer("seed", 0)
    shard_rows = table.integer("shard_rows", SHARD_ROWS, 1, LARGEST_SEQUENCE)
    simulation = table.table("simulation")
    if simulator is None:
        simulator = read_simulator(table, arch)
    shortest_s, longest_s = run_lengths_s(simulator)
    horizon_s = simulation.number("duration_s", HORIZON_S, shortest_s, longest_s)
    simulation.done()
    check_simulator(simulator)
    rule = simulator.read_worlds(table)
    families = _read_families(table, simulator, horizon_s)
    repertoire = _read_repertoire(table, simulator, families)
    samples = samples or configured
    rows = samples + (repertoire.candidates if repertoire else 0)
    specification = Specification(
        simulator=simulator.lasting(horizon_s),
        samples=samples,
        shard_rows=shard_rows,
        seed=seed,
        horizon_s=horizon_s,
        rule=rule,
        outcomes=_read_kept(table, simulator, families, rows),
        families=families,
        repertoire=repertoire,
    )
    table.done()
    # A column may be "origin", and one family's name may begin another's.
    names = specification.schema.names
    for name in names:
        if names.count(name) > 1:
            allowed = "names of columns and families that give each column of a store another name"
            raise InputError(SIMULATOR_KEY, name, allowed)
    return specification


def read_simulator(table: Table, arch: str | None) -> Simulator:
    """The simulator that a configuration names, by a text or by a table with its settings."""
    if isinstance(table.unread.get(SIMULATOR_KEY), str):
        return find_simulator(table.text(SIMULATOR_KEY), table.folder).read(table, arch)
    own = table.table(SIMULATOR_KEY)
    if own.mistaken("name"):  # again: which other keys there are is its matter
        raise InputError(own.path("name"), "missing", "the name of a simulator")
    simulator = find_simulator(own.text("name", WALKER), table.folder).read(table, arch)
    own.done()
    return simulator


def run_lengths_s(simulator: Simulator) -> tuple[float, float]:
    """How long a run of a simulator may be, at least and at most."""
    return WALKS_S if simulator.name == WALKER else HORIZONS_S


def _other_keys(document: dict[str, Any], taken: Set[str]) -> dict[str, Any]:
    """The document of a simulator or of a rule, which has no key that is taken."""
    for key in document:
        if key in taken:
            names = listed(sorted(taken), key)
            allowed = f"a document of the simulator or its worlds without {names}"
            raise InputError(SIMULATOR_KEY, key, allowed)
    return document


def _read_families(
    table: Table, simulator: Simulator, horizon_s: float
) -> tuple[Family, ...]:
    """The tables [robust] and [families.<name>] of a store: robust first, the others by name.

    Families that come after another one are last.
    """
    others, families = table.table("families"), list[Family]()
    lasted_s, walked_s = LEAST_SHARE * horizon_s, horizon_s
    if simulator.name == WALKER:  # of which stores without these keys have been begun
        lasted_s, walked_s = (
            min(LEAST_LASTED_S, horizon_s),
            max(LEAST_WALK_S, horizon_s),
        )
    shortest_s, longest_s = run_lengths_s(simulator)
    named = {name: others.table(name) for name in sorted(others.unread)}
    for name in named:
        if not re.fullmatch(NAME_PATTERN, name):
            allowed = "lower-case letters, digits and '_', first a letter"
            raise InputError("families", name, allowed)
        if name == ROBUST:
            raise InputError(
                "families", name, "another name; this family is the table [robust]"
            )
        # Else its columns could be taken for others.
        for column in arrow_schema(simulator).names:
            if f"{column}_".startswith(f"{name}_"):
                allowed = f"a name that does not begin a column's ({column})"
                raise InputError("families", name, allowed)
    for name, own in {ROBUST: table.table(ROBUST), **named}.items():
        default, least = (0, 0) if name == ROBUST else (REQUIRED, 1)
        if count := own.integer("settings", default, least, MOST_WORLDS):
            after = own.text("after", "") if name != ROBUST else ""
            last = (
                own.number("min_survived_fraction", low=0.0, high=1.0) if after else 0.0
            )
            family = Family(
                name=name,
                settings=count,
                after=after,
                min_survived_fraction=last,
                min_survival_s=own.number("min_survival_s", lasted_s, 0.0, horizon_s),
                horizon_s=own.number("horizon_s", walked_s, shortest_s, longest_s),
                seed=own.integer("seed", 0),
                rule=simulator.read_worlds(own),
            )
            families.append(family)
        own.done()
    first = [family for family in families if not family.after]
    later = [family for family in families if family.after]
    for family in later:
        if family.after not in (names := [each.name for each in first]):
            known = listed(names, family.after) or "there is none"
            allowed = f"a family that comes after none: {known}"
            raise InputError(f"families.{family.name}.after", family.after, allowed)
    return (*first, *later)


def _read_kept(
    table: Table, simulator: Simulator, families: tuple[Family, ...], rows: int
) -> tuple[str, ...]:
    """The columns that a store of so many rows keeps of each world; `kept` names them.

    The walker's, which come beside others, it has read itself.
    """
    if table.has("kept"):
        named = table.texts("kept", tuple(simulator.scores))
        return tuple(dict.fromkeys((simulator.survived, *named)))
    worlds = sum(family.settings for family in families)
    number_b = np.dtype(simulator.outcome_type).itemsize
    size_b = rows * worlds * len(simulator.outcomes) * number_b
    if size_b > MOST_OUTCOMES_B and simulator.name != WALKER:
        allowed = f"a list of the columns that costs read: all would take {size_b / 1e9:.0f} GB"
        raise InputError("kept", "missing", allowed)
    return simulator.outcomes


def _read_repertoire(
    table: Table, simulator: Simulator, families: tuple[Family, ...]
) -> Repertoire | None:
    """The table [repertoire] of a store, or None where there is none. Reads every key."""
    own = table.table("repertoire")
    if not own.unread:
        return None
    if not simulator.measures:
        raise InputError("repertoire", simulator.name, "a simulator that has measures")
    first = {family.name: family for family in families if not family.after}
    names = own.texts("families") or tuple(first)
    for name in names:
        if name not in first:
            known = listed(first, name) or "there is none"
            allowed = f"families that come after none: {known}"
            raise InputError(own.path("families"), name, allowed)
    if not first:
        raise InputError(
            "repertoire", "no family", "a store with [families.<name>] or [robust]"
        )
    if any(f"{ORIGIN}_".startswith(f"{family.name}_") for family in families):
        raise InputError(
            "families", ORIGIN, "another name; it is a column of this store"
        )
    evaluations = own.integer("evaluations", 100_000, 1, LARGEST_NUMBER)
    candidates = own.integer("candidates", 2000, 1, LARGEST_NUMBER)
    settings = own.integer("settings", SEARCH_WORLDS, 1, MOST_WORLDS)
    bred = tuple(first[name] for name in sorted(names))
    repertoire = Repertoire(
        evaluations=evaluations,
        candidates=candidates,
        seed=own.integer("seed", 0),
        settings=settings,
        families=bred,
    )
    own.done()
    if candidates < len(bred):
        raise InputError(
            "repertoire.candidates", candidates, f"at least {len(bred)}, one a family"
        )
    # A search keeps no more than half of what it tries.
    generations = max(len(bred), -(-2 * candidates // GENERATION))
    least = (STARTS * len(bred) + generations * GENERATION) * settings
    if evaluations < least:
        allowed = f"at least {least} for {candidates} candidates"
        raise InputError("repertoire.evaluations", evaluations, allowed)
    return repertoire


def library_version() -> str:
    """The version of the library that searches.

    Raises:
        InputError: it is not installed.
    """
    try:
        return version(LIBRARY)
    except PackageNotFoundError:
        allowed = f"an environment with {LIBRARY}: pip install 'taichi-nmm[repertoire]'"
        raise InputError(LIBRARY, "missing", allowed) from None
