"""Proposals between the rows of a table: points near the best rows and trials.

Points are many, and what rows tell of them is guessed in batches: of each from the rows
near the centre that is nearest to it. A point far from its centre has others near it. Of
costs that does not matter: points that are guessed from their own rows, the best one
first, were no better (a plant, 54 of them: 13:17 and 6:17 after 30 trials). A risk that
is allowed is certain only by a point's own rows, so that of the chosen one is asked
again.
"""

from functools import partial

import numpy as np

from study.sampler.acquisition import Model, argmax_random_tie
from study.sampler.arrays import Floats
from study.sampler.covariance import Kernel
from study.sampler.draws import Purpose
from study.sampler.history import OFF_TABLE, History, notes_of
from study.sampler.policy import (
    NOTHING,
    Policy,
    Proposal,
    call_features,
    rows_fail,
)
from study.sampler.risk import Certificate, Places
from study.sampler.rows import Rows
from study.sampler.space import nearby, not_among, not_near
from study.sampler.transforms import Points

CENTRES = 8  # best rows that points off the table are near to
INCUMBENTS = 3  # and best trials


def best_off_table(
    policy: Policy,
    rows: Rows,
    history: History,
    model: Model,
    own_turn: int,
    known: Points,
    utility: Floats,
    certificate: Certificate | None,
) -> tuple[float, Proposal]:
    """The best of some points near the best rows and trials, and its utility or infinity.

    Beside worlds no point that repeats a trial, unless nothing else is left: repeats are
    asked for by enqueuing them.

    Args:
        policy: whose proposal it is.
        rows: of the table, as the study suggests them.
        history: of the study.
        model: after its trials.
        own_turn: of the trial.
        known: rows that may be proposed, m of them.
        utility: of these, [m].
        certificate: of the risk that is allowed; None: any.
    """
    space, function = rows.space, policy.function
    order = np.lexsort((history.cost, ~model.feasible))
    centres = history.done.parameters[order[:INCUMBENTS]]
    if function is not None:
        best = np.argsort(-utility, kind="stable")[:CENTRES]
        best = best[np.isfinite(utility[best])]
        centres = np.vstack([rows.parameters[rows.numbers[best]], centres])
    rng = policy.rng(Purpose.OFF_GRID, own_turn)
    count = policy.options.off_grid
    near = nearby(space.pinned(history.fixed), centres, count, rng)
    unit, taken = space.unit(near), space.unit(history.taken)
    new = not_among(unit, taken)
    features = np.full((len(near), len(rows.feature_names)), np.nan)
    if function is not None:
        features = call_features(function, near, features.shape[1])
        is_known = np.asarray(~np.isnan(features).any(axis=1))
        new = new & is_known if (new & is_known).any() else is_known
        points = points_of(rows, policy.options.kernel, near, features)
    else:
        elsewhere = new & not_near(unit, taken)
        if np.isfinite(utility).any() or elsewhere.any():
            new = elsewhere
        between = rows.between(model.ensemble)
        points = Points(between.at(known.features, unit, space.unit(centres)), unit)
    if certificate is not None:
        places = Places(np.full(len(unit), OFF_TABLE), unit, space.unit(centres))
        new = new & certificate.within(places, points)
        if not new.any():
            return -np.inf, NOTHING
    rng = policy.rng(Purpose.OFF_GRID_UTILITY, own_turn)
    found = model.utility(points, new, rng)
    chosen = argmax_random_tie(found, rng)
    if certificate is not None:
        within = partial(_is_within, certificate, rows, known, model)
        while found[chosen] > -np.inf and not within(points, unit, chosen):
            found[chosen] = -np.inf
            chosen = argmax_random_tie(found, rng)
        if found[chosen] == -np.inf:
            return -np.inf, NOTHING
    value = float(found[chosen])
    if value > -np.inf and rows_fail(model):
        value = np.inf
    notes = notes_of(OFF_TABLE, features[chosen])
    return value, Proposal(space.values(near[chosen]), notes)


def _is_within(
    certificate: Certificate,
    rows: Rows,
    known: Points,
    model: Model,
    points: Points,
    unit: Floats,
    chosen: int,
) -> bool:
    """Whether a point's risk is allowed by what the rows nearest to itself tell of it."""
    some = np.array([chosen])
    point = points.take(some)
    if model.ensemble is not None:
        own = rows.between_at(known, unit[chosen], model.ensemble)
        point = Points(own[None], unit[some])
    places = Places(np.array([OFF_TABLE]), unit[some])
    return bool(certificate.within(places, point).all())


def points_of(
    rows: Rows, kernel: Kernel, parameters: Floats, features: Floats
) -> Points:
    """Parameters [m, d] and features [m, k] as the kernel sees them, on the scale of the rows."""
    unit = np.empty((len(parameters), 0))
    if kernel.of_parameters:
        unit = rows.space.unit(parameters)
    scale = rows.scale(by_order=kernel.by_order)
    return Points(scale.standard(features), unit)
