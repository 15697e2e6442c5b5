"""Proposals between the rows of a table: points near the best rows and trials.

Points are many, and what rows tell of them is guessed in batches: of each from the rows
near the centre that is nearest to it. A point far from its centre has others near it. Of
costs that does not matter: points that are guessed from their own rows, the best one
first, were no better (a plant, 54 of them: 13:17 and 6:17 after 30 trials). A risk that
is allowed is certain only by a point's own rows, so that of the chosen one is asked
again.
"""

from typing import NamedTuple

import numpy as np

from study.sampler.acquisition import Model, argmax_random_tie
from study.sampler.arrays import Floats, Mask
from study.sampler.draws import Purpose
from study.sampler.history import OFF_TABLE, History, notes_of
from study.sampler.policy import (
    NOTHING,
    Policy,
    Proposal,
    call_features,
    points_of,
    rows_fail,
)
from study.sampler.risk import Certificate, Places
from study.sampler.rows import Rows, once
from study.sampler.space import keys, nearby, not_among, not_near
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
    near = _near(policy, rows, history, model, own_turn, known, utility)
    new, centres = near.new, rows.space.unit(near.centres)
    if certificate is not None:
        everywhere = Places(np.full(len(new), OFF_TABLE), near.unit, centres)
        new = new & certificate.within(everywhere, near.points)

    def holds(place: int) -> bool:
        if certificate is None:
            return True
        some = np.array([place])
        point, unit = near.points.take(some), near.unit[some]
        if policy.function is None:
            own = rows.between_at(known, unit[0], model.ensemble)
            point = Points(own[None], unit)
        alone = Places(np.array([OFF_TABLE]), unit)
        return bool(certificate.within(alone, point).all())

    rng = policy.rng(Purpose.OFF_GRID_UTILITY, own_turn)
    found = model.utility(near.points, new, rng)
    chosen = argmax_random_tie(found, rng)
    while found[chosen] > -np.inf and not holds(chosen):
        found[chosen] = -np.inf
        chosen = argmax_random_tie(found, rng)
    value = float(found[chosen])
    if value == -np.inf and certificate is not None:
        return value, NOTHING
    if value > -np.inf and rows_fail(model):
        value = np.inf
    notes = notes_of(OFF_TABLE, near.features[chosen])
    return value, Proposal(rows.space.values(near.parameters[chosen]), notes)


class Near(NamedTuple):
    """Points near the best rows and trials.

    Attributes:
        parameters: of k points, [k, d].
        unit: in the unit cube, [k, e].
        features: to be noted, [k, f]; NaN where no function computes them.
        points: as the model sees them.
        new: which are not taken, [k].
        centres: that they are near to, [c, d].
    """

    parameters: Floats
    unit: Floats
    features: Floats
    points: Points
    new: Mask
    centres: Floats


def _near(
    policy: Policy,
    rows: Rows,
    history: History,
    model: Model,
    own_turn: int,
    known: Points,
    utility: Floats,
) -> Near:
    """Points that may be proposed; arguments as of `best_off_table`."""
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
    new = not_among(unit, taken) & ~_are_rows(rows, unit)
    features = np.full((len(near), len(rows.feature_names)), np.nan)
    are_rows_left = bool(np.isfinite(utility).any())
    if function is not None:
        features = call_features(function, near, features.shape[1])
        is_known = np.asarray(~np.isnan(features).any(axis=1))
        known_and_new = new & is_known
        new = known_and_new if known_and_new.any() or are_rows_left else is_known
        points = points_of(rows, policy.options.kernel, near, features)
    else:
        elsewhere = new & not_near(unit, taken)
        new = elsewhere if elsewhere.any() or are_rows_left else new
        between = rows.between(model.ensemble)
        points = Points(between.at(known.features, unit, space.unit(centres)), unit)
    return Near(
        parameters=near,
        unit=unit,
        features=features,
        points=points,
        new=new,
        centres=centres,
    )


def _are_rows(rows: Rows, unit: Floats) -> Mask:
    """Which points are rows, [k]: these are proposed as such, or not at all."""
    known = once(rows, "keys", lambda: set(keys(rows.space.unit(rows.parameters))))
    return np.array([key in known for key in keys(unit)], dtype=bool)
