"""The arms: ways of choosing trials. Each has a sampler, a store that it reads, and a label.

An arm is added here and nowhere else: studies, comparisons and reports take it from
this list.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from optuna.samplers import BaseSampler, NSGAIISampler, TPESampler

from storage.inputs.errors import InputError, listed
from storage.store import open_store
from study.experiment import samplers
from study.experiment.experiment import Experiment, candidates, check_store
from study.experiment.features import IN_WORLDS, RANKING, WORLDS
from study.experiment.objective import SUCCESS_SPEED_MPS
from study.experiment.samplers import Task
from study.sampler.draws import Purpose, ReproducibleRandomSampler, seed_32bit
from study.sampler.sampler import PAPER, FeatureKernelSampler
from study.sampler.table import FeatureTable
from taichi_nmm.conditions import TRIAL_S

PAPER_ARM = "dog"  # the paper's
OUR_ARM = "worlds"  # ours, to which all others are compared; to the paper's where it is missing
# peers are of others, or plain; controls: no model
Kind = Literal["ours", "peer", "control"]

PRINTED = "phi_printed"
NOTHING = "nothing but its own trials"  # what an arm without a store has seen

NewSampler = Callable[[Task], BaseSampler]


@dataclass(frozen=True)
class Arm:
    """A way of choosing trials.

    Attributes:
        name: in commands and files.
        label: in figures and tables.
        kind: "ours", "peer" (of others, or plain) or "control" (without a model).
        summary: in a line.
        new_sampler: makes the sampler of a study or, where it is `fresh`, of one trial.
        store: key of the store that it reads, in the configuration's [stores]; "":
            none.
        feature: a column of that store, or one of `IN_WORLDS`; "": none.
        fresh: whether each trial has a new sampler, since the library keeps a state in
            it.
        replayed: whether the library keeps a state, in trials or in the sampler, which a
            resumed study repeats.
        takes_goals: whether it takes two goals; if not, one cost alone.
        options: that decide its proposals as well, as JSON values.
        needs: package that must be installed, which is none of this project's own; "":
            none.
    """

    name: str
    label: str
    kind: Kind
    summary: str
    new_sampler: NewSampler
    store: str = ""
    feature: str = ""
    fresh: bool = False
    replayed: bool = False
    takes_goals: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    needs: str = ""

    @property
    def definition(self) -> dict[str, Any]:
        """All that decides its proposals, as JSON values; trials of two definitions never mix."""
        features: list[Any] = [self.feature] if self.feature else []
        if self.feature in IN_WORLDS:
            features = [[self.feature, f"cost of a trial of {TRIAL_S:g} s"]]
        return {
            "store": self.store,
            "features": features,
            "options": dict(self.options),
        }


def find_arm(name: str) -> Arm:
    """The arm of that name.

    Raises:
        InputError: there is none.
    """
    if name in GONE:
        raise InputError("arm", name, f"{GONE[name]}, in its place since version 0.5")
    if name not in ARMS:
        raise InputError("arm", name, f"one of {listed(ARMS, name)}")
    return ARMS[name]


def _worlds(task: Task) -> BaseSampler:
    """Our sampler over what a store's rows cost in each world, which aims at the first success."""
    experiment = task.experiment
    success = experiment.objective.success(experiment.trial_s)
    return FeatureKernelSampler(task.table, seed=task.seed, success=success)


WORLDS_OPTIONS = {"success_speed_mps": SUCCESS_SPEED_MPS}


def _seeded(sampler: type[TPESampler] | type[NSGAIISampler]) -> NewSampler:
    """A sampler of Optuna's: begun anew at each turn, it draws from the study and the turn."""

    def new_sampler(task: Task) -> BaseSampler:
        return sampler(seed=seed_32bit(task.seed, Purpose.CANDIDATES, task.turn))

    return new_sampler


def _plain(task: Task) -> BaseSampler:
    return FeatureKernelSampler(None, seed=task.seed, space=task.experiment.space)


def _over(made: Callable[[FeatureTable, int], BaseSampler]) -> NewSampler:
    """Of a sampler that is made of an arm's candidates and a seed."""
    return lambda task: made(task.table, task.seed)


_ALL = (
    Arm(
        name="random",
        label="random",
        kind="peer",
        summary="uniform random",
        new_sampler=lambda task: ReproducibleRandomSampler(seed=task.seed),
        takes_goals=True,
    ),
    Arm(
        name="cmaes-cold",
        label="CMA-ES",
        kind="peer",
        summary="CMA-ES from a random mean",
        new_sampler=samplers.ColdCmaEsSampler,
        fresh=True,
        replayed=True,
        options={"sigma": samplers.SIGMA_COLD},
    ),
    Arm(
        name="cmaes-warm",
        label="CMA-ES, warm",
        kind="peer",
        summary="CMA-ES from one of the 100 best rows",
        new_sampler=samplers.WarmCmaEsSampler,
        store="flat",
        feature=PRINTED,
        options={"sigma": samplers.SIGMA_WARM, "rows": samplers.START_ROWS},
    ),
    Arm(
        name="bo-euclidean",
        label="plain BO",
        kind="peer",
        summary="Bayesian optimisation over the gains, ours",
        new_sampler=_plain,
        takes_goals=True,
    ),
    Arm(
        name="tpe",
        label="TPE",
        kind="peer",
        summary="Optuna's TPESampler",
        new_sampler=_seeded(TPESampler),
        fresh=True,
        takes_goals=True,
    ),
    Arm(
        name="nsga2",
        label="NSGA-II",
        kind="peer",
        summary="Optuna's NSGAIISampler",
        new_sampler=_seeded(NSGAIISampler),
        fresh=True,
        replayed=True,
        takes_goals=True,
    ),
    Arm(
        name=PAPER_ARM,
        label="DoG, as printed",
        kind="ours",
        summary="the paper's method: kernel over the score",
        new_sampler=lambda task: FeatureKernelSampler(
            task.table, seed=task.seed, **PAPER
        ),
        store="flat",
        feature=PRINTED,
        options=PAPER,
    ),
    Arm(
        name=OUR_ARM,
        label="worlds",
        kind="ours",
        summary="learns which world of its store the robot is like",
        new_sampler=_worlds,
        store="worlds",
        feature=WORLDS,
        takes_goals=True,
        options=WORLDS_OPTIONS,
    ),
    Arm(
        name="ranking",
        label="ranking",
        kind="control",
        summary="the rows of worlds by their mean cost, without a model",
        new_sampler=_over(samplers.RankedSampler),
        store="worlds",
        feature=RANKING,
    ),
    Arm(
        name="bo-ranking",
        label="plain BO after 3",
        kind="peer",
        summary="the ranking's first three rows, then Bayesian optimisation over the gains",
        new_sampler=lambda task: samplers.RankedSampler(
            task.table, task.seed, then=_plain(task)
        ),
        store="worlds",
        feature=RANKING,
    ),
    Arm(
        name="hill-ranking",
        label="hill climber after 3",
        kind="peer",
        summary="the ranking's first three rows, then steps from the best trial",
        new_sampler=_over(samplers.hill_ranking),
        store="worlds",
        feature=RANKING,
        options={"sigma": samplers.HILL_SIGMA},
    ),
    Arm(
        name="residual",
        label="residual BO",
        kind="peer",
        summary="Bayesian optimisation of what the mean over the worlds leaves",
        new_sampler=_over(samplers.residual),
        store="worlds",
        feature=RANKING,
    ),
    Arm(
        name="tpe-ranking",
        label="TPE after 3",
        kind="peer",
        summary="the ranking's first three rows, then Optuna's TPESampler",
        new_sampler=_over(samplers.tpe_ranking),
        store="worlds",
        feature=RANKING,
        replayed=True,
    ),
    Arm(
        name="gp-ranking",
        label="GPSampler after 3",
        kind="peer",
        summary="the ranking's first three rows, then Optuna's GPSampler",
        new_sampler=_over(samplers.gp_ranking),
        store="worlds",
        feature=RANKING,
        replayed=True,
        needs="torch",
    ),
    Arm(
        name="worlds-stairs",
        label="worlds, stairs' store",
        kind="ours",
        summary="worlds, having seen other stairs alone",
        new_sampler=_worlds,
        store="stairs",
        feature=WORLDS,
        takes_goals=True,
        options=WORLDS_OPTIONS,
    ),
)

ARMS: dict[str, Arm] = {arm.name: arm for arm in _ALL}
GONE = {"gp": "gp-ranking", "cmaes": "cmaes-cold"}


def lacks(name: str) -> str:
    """What an arm needs and is not installed, in words; "": nothing."""
    needs = find_arm(name).needs
    if not needs or find_spec(needs) is not None:
        return ""
    return f"it needs {needs} (pip install {needs})"


def check_arms(
    experiment: Experiment, names: Sequence[str], trials: int
) -> tuple[Arm, ...]:
    """The arms of these names, each found able to run `trials` trials of the experiment.

    Raises:
        InputError: no arm at all, an unknown one, one that takes no goals where there
            are two, or one whose store is missing, of other parameters, without a
            feature, or with fewer rows than trials.
    """
    if not names:
        raise InputError(
            "arms", "none", "one arm or more, in the configuration or by --arms"
        )
    arms = tuple(find_arm(name) for name in dict.fromkeys(names))
    for arm in arms:
        if lacking := lacks(arm.name):
            raise InputError("arm", arm.name, f"another: {lacking}")
        if experiment.objective.goals and not arm.takes_goals:
            able = ", ".join(name for name, each in ARMS.items() if each.takes_goals)
            raise InputError("arm", arm.name, f"with two goals one of {able}")
        if not arm.store:
            continue
        store = check_store(experiment, arm.store)
        rows = int(candidates(experiment, arm.store, arm.feature).rows.offered.sum())
        if trials > rows:
            allowed = f"at most {rows}, the rows that {arm.name} may take of the store {store.path}"
            raise InputError("trials", trials, allowed)
    return arms


def with_store(experiment: Experiment, names: Sequence[str], path: Path) -> Experiment:
    """The experiment with a store of the caller's, in place of the one that the arms read.

    Raises:
        InputError: an unknown arm, or arms that read no store or several.
    """
    read = sorted({arm.store for arm in map(find_arm, names) if arm.store})
    if len(read) != 1:
        found = f"{', '.join(names)}: {' and '.join(read) or 'none'}"
        raise InputError("store", str(path), f"with arms that read one store; {found}")
    return replace(experiment, stores={**experiment.stores, read[0]: path})


def saw(arm: Arm, stores: Mapping[str, Path]) -> str:
    """The bodies and grounds that an arm's store had seen before the first trial, in words.

    `stores` are folders by key. If the arm's store is missing or cannot be read, its
    key is given.
    """
    if not arm.store:
        return NOTHING
    in_worlds = arm.feature in IN_WORLDS
    grounds: dict[str, dict[str, None]] = {}
    try:
        store = open_store(stores[arm.store])
        base = store.specification
        families = store.families if in_worlds else ()
        for setting in (base, *map(store.settings_of, families)):
            percent = 100.0 * setting["body"]["disturbance"]
            body = (
                f"bodies disturbed by {percent:g} %" if percent else "undisturbed body"
            )
            if "world" in setting:
                body += ", in worlds that differ"
            ground = str(setting["terrain"]["name"])
            name = "level ground" if ground == "flat" else ground
            grounds.setdefault(body, {})[name] = None  # once each, in their order
    except (KeyError, TypeError, InputError):  # of another simulator, or edited
        families_too = ", and its families" if in_worlds else ""
        return f"base setting of the store {arm.store}{families_too}"
    return "; ".join(f"{body}: {'; '.join(found)}" for body, found in grounds.items())
