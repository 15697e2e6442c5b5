"""Samplers of others that learn from earlier studies, each as its own documentation has it.

The worlds of a target are the earlier studies. None of the packages is this project's
own: install them in an environment apart.

    pip install botorch baybe optunahub

`MultiTaskGP` follows BoTorch's documentation, BayBE its guide to transfer learning,
MetaLearnTPE its page on OptunaHub. An exact Gaussian process takes hundreds of
measurements, not tens of thousands: these are told some rows of each world.
"""

import sys
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import CategoricalDistribution
from optuna.samplers._tpe.sampler import _split_trials, default_gamma
from optuna.trial import create_trial

from study.experiment.samplers import FIRST_ROWS, RankedSampler
from study.sampler.table import FeatureTable
from tools.measured import Target
from tools.runs import Batches, Floats, study_costs

Rows = NDArray[np.int64]

BEST, DRAWN = 10, 20  # rows of each world that a Gaussian process is told
MOST_STUDIED = 1000  # rows of each world that MetaLearnTPE is told
# Of a fit of MultiTaskGP's constants: without an end it takes a minute and more.
FIT_ITERATIONS = 200
HUB_PACKAGE = "samplers/meta_learn_tpe"


class Told(NamedTuple):
    """What a peer is told of the worlds, and how it sees the candidates.

    Attributes:
        points: of all n candidates, in the unit cube, [n, coordinates].
        rows: of each of w worlds, [w, told].
        values: what these rows cost there, [w, told]; more is better.
        value: turns costs of the target into values, [...] -> [...].
    """

    points: Floats
    rows: NDArray[np.int64]
    values: Floats
    value: Callable[[Floats], Floats]


def told(target: Target, seed: int) -> Told:
    """The best rows of each world, and some that the seed draws.

    Times are told as logarithms, and a failure as the worst of its world.
    """
    scale = np.log if target.is_time else np.asarray

    def value(costs: Floats) -> Floats:
        ran = costs[np.isfinite(costs)]
        worst = ran.max() if len(ran) else 1.0
        return np.asarray(-scale(np.where(np.isfinite(costs), costs, worst)))

    values = np.array([value(world) for world in target.outcomes.T])
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    rows = np.array(
        [
            [*order[:BEST], *rng.choice(order[BEST:], DRAWN, replace=False)]
            for order in np.argsort(-values, axis=1, kind="stable")
        ]
    )
    return Told(target.points, rows, np.take_along_axis(values, rows, axis=1), value)


# Given what was told, candidates that are left, those that were tried, their values, and
# how many to propose.
Proposes = Callable[[Told, Rows, Rows, Floats, int], Rows]


def after_ranking(made: Callable[[int], Proposes]) -> Callable[..., Floats]:
    """Costs of a study: first the best rows by the mean over the worlds, then as proposed."""

    def costs(target: Target, seed: int, batches: Batches) -> Floats:
        known, proposes = told(target, seed), made(seed)
        ranked = np.argsort(target.outcomes.mean(axis=1), kind="stable")
        tried: list[int] = []
        for size in batches:
            first = ranked[len(tried) : FIRST_ROWS][:size]
            tried += first.tolist()
            if size > len(first):
                done = np.array(tried)
                left = np.setdiff1d(np.arange(len(target)), done)
                values = known.value(target.cost[done])
                tried += proposes(known, left, done, values, size - len(first)).tolist()
        return np.asarray(target.cost[tried])

    return costs


def torch_of(seed: int) -> Any:
    """PyTorch on one thread, seeded."""
    import torch

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    return torch


def multi_task(seed: int) -> Proposes:
    """BoTorch's MultiTaskGP, a task a world, and log expected improvement on the target's."""
    torch = torch_of(seed)

    def proposes(
        known: Told, left: Rows, tried: Rows, values: Floats, size: int
    ) -> Rows:
        from botorch import fit_gpytorch_mll
        from botorch.acquisition import qLogExpectedImprovement
        from botorch.models import MultiTaskGP
        from botorch.models.transforms.outcome import StratifiedStandardize
        from botorch.optim import optimize_acqf_discrete
        from gpytorch.mlls import ExactMarginalLogLikelihood

        own = len(known.rows)  # the target's number, after those of the worlds
        rows = np.concatenate([known.rows.ravel(), tried])
        tasks = [*np.repeat(np.arange(own), known.rows.shape[1]), *[own] * len(tried)]
        x = torch.tensor(np.column_stack([known.points[rows], tasks]))
        y = torch.tensor(np.concatenate([known.values.ravel(), values]))[:, None]
        by_task = StratifiedStandardize(
            stratification_idx=x.shape[1] - 1, all_task_values=torch.arange(own + 1.0)
        )
        model = MultiTaskGP(
            x, y, task_feature=-1, output_tasks=[own], outcome_transform=by_task
        )
        fit_gpytorch_mll(
            ExactMarginalLogLikelihood(model.likelihood, model),
            optimizer_kwargs={"options": {"maxiter": FIT_ITERATIONS}},
        )
        of_target = np.full(len(left), own)
        choices = torch.tensor(np.column_stack([known.points[left], of_target]))
        found, _ = optimize_acqf_discrete(
            qLogExpectedImprovement(model, best_f=values.max()),
            q=size,
            choices=choices,
            unique=True,
        )
        same = (choices[None] == found[:, None]).all(dim=-1)
        return np.asarray(left[same.double().argmax(dim=1).numpy()])

    return proposes


def baybe(target: Target, seed: int, batches: Batches) -> Floats:
    """Costs of a campaign of BayBE with a task parameter, of which the target's value is active."""
    import pandas as pd
    from baybe import Campaign, Settings
    from baybe.parameters import (
        CategoricalParameter,
        NumericalDiscreteParameter,
        TaskParameter,
    )
    from baybe.searchspace import SearchSpace
    from baybe.targets import NumericalTarget

    torch_of(seed)
    known, own = told(target, seed), "target"
    names = [*(f"world {place}" for place in range(len(known.rows))), own]
    parameters: list[Any] = [
        CategoricalParameter(name, np.unique(column).tolist())
        if isinstance(target.space[name], CategoricalDistribution)
        else NumericalDiscreteParameter(name, np.unique(column).astype(float).tolist())
        for name, column in target.columns.items()
    ]
    parameters.append(TaskParameter("machine", names, active_values=[own]))
    frame = pd.DataFrame(target.columns)
    space = SearchSpace.from_dataframe(frame.assign(machine=own), parameters)
    with Settings(random_seed=seed % 2**32):
        campaign = Campaign(space, NumericalTarget("value").to_objective())
        for name, rows, values in zip(names, known.rows, known.values, strict=False):
            campaign.add_measurements(
                frame.iloc[rows].assign(machine=name, value=values)
            )
        tried: list[int] = []
        for size in batches:
            proposed = campaign.recommend(size)
            rows = [target.row_nearest_to(each) for each in proposed.to_dict("records")]
            tried += rows
            # a failure is told as the worst so far
            values = known.value(target.cost[tried])[-len(rows) :]
            campaign.add_measurements(proposed.assign(value=values))
    return np.asarray(target.cost[tried])


def hub_lacks() -> str:
    """Why the package of OptunaHub cannot be loaded, in words; "": it can."""
    try:
        hub_module()
    except Exception as error:  # of git, GitHub or the network: each has its own
        return f"OptunaHub's {HUB_PACKAGE} cannot be loaded: {type(error).__name__}"
    return ""


def hub_module() -> Any:
    """The package, from the network or from OptunaHub's own cache.

    It was written for Optuna 4, and calls private functions of which Optuna 5 has
    changed one.
    """
    import optunahub

    module = optunahub.load_module(HUB_PACKAGE)

    def split(study: Any, trials: Any, below: int, **_: bool) -> Any:
        return _split_trials(study, trials, below)

    vars(sys.modules[module.MetaLearnTPESampler.__module__])["_split_trials"] = split
    return module


def meta_learn_tpe(target: Target, seed: int, batches: Batches) -> Floats:
    """Costs of a study whose sampler knows a finished study of each world."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    studies = []
    for world in target.outcomes.T:
        size = min(len(target), MOST_STUDIED)
        rows = np.sort(rng.choice(len(target), size, replace=False))
        studies.append(optuna.create_study())
        studies[-1].add_trials(
            create_trial(
                params=target.settings(row),
                distributions=target.space,
                value=float(world[row]),
            )
            for row in rows
        )
    peer = hub_module().MetaLearnTPESampler(
        source_studies=studies, n_startup_trials=FIRST_ROWS, seed=seed % 2**32
    )
    for sampler in (peer._target_sampler, *peer._source_samplers):
        # Since Optuna 5 a new TPESampler has none; this is what it takes for itself.
        sampler._gamma = default_gamma
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        score = -target.outcomes.mean(axis=1)
        table = FeatureTable.from_arrays(target.columns, score, space=target.space)
    return study_costs(target, RankedSampler(table, seed, then=peer), batches)
