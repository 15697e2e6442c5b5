"""The arms: ways of choosing trials. Each has a sampler, a store that it reads, and a label.

An arm is added here and nowhere else: studies, comparisons and reports take it from
this list.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
from taichi_nmm.conditions import TRIAL_S

PAPER_ARM = "dog"  # the paper's
OUR_ARM = "worlds"  # ours, to which all others are compared; to the paper's where it is missing
Kind = Literal[
    "ours", "peer", "control"
]  # peers are of others, or plain; controls: no model

PRINTED = "phi_printed"
NOTHING = "nothing but its own trials"  # what an arm without a store has seen


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
        replayed: whether the library keeps a state in trials, which a resumed study
            repeats.
        takes_goals: whether it takes two goals; if not, one cost alone.
        options: that decide its proposals as well, as JSON values.
    """

    name: str
    label: str
    kind: Kind
    summary: str
    new_sampler: Callable[[Task], BaseSampler]
    store: str = ""
    feature: str = ""
    fresh: bool = False
    replayed: bool = False
    takes_goals: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def definition(self) -> dict[str, Any]:
        """All that decides its proposals, as JSON values; trials of two definitions never mix."""
        in_worlds = [self.feature, f"cost of a trial of {TRIAL_S:g} s"]
        features = [in_worlds if self.feature in IN_WORLDS else self.feature] * bool(
            self.feature
        )
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
    if name not in ARMS:
        raise InputError("arm", name, f"one of {listed(ARMS, name)}")
    return ARMS[name]


def _worlds_arm(name: str, label: str, summary: str, store: str) -> Arm:
    """Our sampler over what a store's rows cost in each world, which aims at the first success."""

    def new_sampler(task: Task) -> BaseSampler:
        of = task.experiment
        success = of.objective.success(of.conditions.duration_s)
        return FeatureKernelSampler(task.table, seed=task.seed, success=success)

    options = {"success_speed_mps": SUCCESS_SPEED_MPS}
    return Arm(
        name,
        label,
        "ours",
        summary,
        new_sampler,
        store,
        WORLDS,
        takes_goals=True,
        options=options,
    )


def _plain(task: Task) -> BaseSampler:
    return FeatureKernelSampler(None, seed=task.seed, space=task.experiment.space)


_ALL = (
    Arm(
        "random",
        "random",
        "peer",
        "uniform random",
        lambda task: ReproducibleRandomSampler(seed=task.seed),
        takes_goals=True,
    ),
    Arm(
        "cmaes-cold",
        "CMA-ES",
        "peer",
        "CMA-ES from a random mean",
        samplers.ColdCmaEsSampler,
        fresh=True,
        replayed=True,
        options={"sigma": samplers.SIGMA_COLD},
    ),
    Arm(
        "cmaes-warm",
        "CMA-ES, warm",
        "peer",
        "CMA-ES from one of the 100 best rows",
        samplers.WarmCmaEsSampler,
        "flat",
        PRINTED,
        options={"sigma": samplers.SIGMA_WARM, "rows": samplers.START_ROWS},
    ),
    Arm(
        "bo-euclidean",
        "plain BO",
        "peer",
        "Bayesian optimisation over the gains, ours",
        _plain,
        takes_goals=True,
    ),
    Arm(
        "tpe",
        "TPE",
        "peer",
        "Optuna's TPESampler",
        lambda task: TPESampler(
            seed=seed_32bit(task.seed, Purpose.CANDIDATES, task.turn)
        ),
        fresh=True,
        takes_goals=True,
    ),
    Arm(
        "nsga2",
        "NSGA-II",
        "peer",
        "Optuna's NSGAIISampler",
        lambda task: NSGAIISampler(
            seed=seed_32bit(task.seed, Purpose.CANDIDATES, task.turn)
        ),
        fresh=True,
        replayed=True,
        takes_goals=True,
    ),
    Arm(
        PAPER_ARM,
        "DoG, as printed",
        "ours",
        "the paper's method: kernel over the score",
        lambda task: FeatureKernelSampler(task.table, seed=task.seed, **PAPER),
        "flat",
        PRINTED,
        options=PAPER,
    ),
    _worlds_arm(
        "worlds",
        "worlds",
        "learns which world of its store the robot is like",
        "worlds",
    ),
    Arm(
        "ranking",
        "ranking",
        "control",
        "the rows of worlds by their mean cost, without a model",
        samplers.RankedSampler,
        "worlds",
        RANKING,
    ),
    Arm(
        "bo-ranking",
        "plain BO after 3",
        "peer",
        "the ranking's first three rows, then Bayesian optimisation over the gains",
        lambda task: samplers.RankedSampler(task, then=_plain(task)),
        "worlds",
        RANKING,
    ),
    _worlds_arm(
        "worlds-stairs",
        "worlds, stairs' store",
        "worlds, having seen other stairs alone",
        "stairs",
    ),
)

ARMS: dict[str, Arm] = {arm.name: arm for arm in _ALL}


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
            body += ", in worlds that differ" * ("world" in setting)
            ground = str(setting["terrain"]["name"])
            name = "level ground" if ground == "flat" else ground
            grounds.setdefault(body, {})[name] = None  # once each, in their order
    except (KeyError, TypeError, InputError):  # of another simulator, or edited
        return (
            f"base setting of the store {arm.store}{', and its families' * in_worlds}"
        )
    return "; ".join(f"{body}: {'; '.join(found)}" for body, found in grounds.items())
