"""Proposals between the rows of a table: points near the best rows and trials.

Points are many, and what rows tell of them is guessed in batches: of each from the rows
near the centre that is nearest to it. A point far from its centre has others near it. Of
costs that does not matter: points that are guessed from their own rows, the best one
first, were no better (a plant, 54 of them: 13:17 and 6:17 after 30 trials). A risk that
is allowed is certain only by a point's own rows, so that of the chosen one is asked
again. Where a simulator can be asked, the points that promise most are simulated
(`study.sampler.asking`).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from study.sampler.acquisition import Model, argmax_random_tie
from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.asking import ASKED, Asked
from study.sampler.draws import Purpose
from study.sampler.history import OFF_TABLE, History, notes_of
from study.sampler.policy import (
    NOTHING,
    Policy,
    Proposal,
    call_features,
    points_of,
)
from study.sampler.risk import Certificate, Places
from study.sampler.rows import Rows, once
from study.sampler.space import keys, nearby, not_among, not_near
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble

CENTRES = 8  # best rows that points off the table are near to
INCUMBENTS = 3  # and best trials


class Near(NamedTuple):
    """Points near the best rows and trials.

    Attributes:
        parameters: of k points, [k, d].
        unit: in the unit cube, [k, e].
        features: to be noted, [k, f]; NaN where no function computes them.
        points: as the model sees them.
        new: which are not taken, [k].
        centres: that they are near to, in the unit cube, [c, e].
    """

    parameters: Floats
    unit: Floats
    features: Floats
    points: Points
    new: Mask
    centres: Floats


@dataclass(frozen=True, eq=False)
class OffTable:
    """The search for a point off a table.

    Attributes:
        policy: whose proposal it is.
        rows: of the table, as the study suggests them.
        history: of the study.
        model: after its trials.
        own_turn: of the trial.
        known: rows that may be proposed, m of them.
        utility: of these, [m].
        asked: simulates points; None: rows alone tell what they cost in worlds.
    """

    policy: Policy
    rows: Rows
    history: History
    model: Model
    own_turn: int
    known: Points
    utility: Floats
    asked: Asked | None = None

    def best(self, certificate: Certificate | None) -> tuple[float, Proposal]:
        """The best of some points near the best rows and trials, and its utility or infinity.

        Beside worlds no point that repeats a trial, unless nothing else is left: repeats
        are asked for by enqueuing them. A certificate is of the risk that is allowed;
        None: any.
        """
        near, rows, policy = self._near(), self.rows, self.policy
        new = near.new
        if certificate is not None:
            everywhere = Places(np.full(len(new), OFF_TABLE), near.unit, near.centres)
            new = new & certificate.within(everywhere, near.points)

        def holds(place: int) -> bool:
            if certificate is None:
                return True
            some = np.array([place])
            point, unit = near.points.take(some), near.unit[some]
            if policy.function is None:
                own = rows.between_at(self.known, unit[0], self.model.ensemble)
                point = Points.of(own[None], unit)
            alone = Places(np.array([OFF_TABLE]), unit)
            return bool(certificate.within(alone, point).all())

        rng = policy.rng(Purpose.OFF_GRID_UTILITY, self.own_turn)
        found = self.model.utility(near.points, new, rng)
        if self.asked is not None:
            found = self._simulated(near, found, self.asked)
        chosen = argmax_random_tie(found, rng)
        while found[chosen] > -np.inf and not holds(chosen):
            found[chosen] = -np.inf
            chosen = argmax_random_tie(found, rng)
        value = float(found[chosen])
        if value == -np.inf:
            if certificate is not None:
                return value, NOTHING
        elif self.model.rows_fail:
            value = np.inf
        notes = notes_of(OFF_TABLE, near.features[chosen], self.model.aim)
        return value, Proposal(rows.space.values(near.parameters[chosen]), notes)

    def _simulated(self, near: Near, utility: Floats, asked: Asked) -> Floats:
        """The utility of the points that promise most, simulated; minus infinity of others, [k].

        Where the simulator tells nothing of any of them, and no row is left either, it is
        that of the others, by what rows tell; of these, if there are no others.
        """
        ensemble, found = self.model.ensemble, np.full(len(utility), -np.inf)
        best = most_promising(near.parameters, utility, ASKED)
        if not len(best) or not isinstance(ensemble, Ensemble):
            return found
        told = asked.columns(near.parameters[best], ensemble)
        is_told = np.asarray(~np.isnan(told).any(axis=1))
        if is_told.any():
            some = near.points.take(best[is_told])
            some.features[:, -told.shape[1] :] = told[is_told]
            rng = self.policy.rng(Purpose.OFF_GRID_UTILITY, self.own_turn)
            offered = np.ones(len(some), dtype=bool)
            found[best[is_told]] = self.model.utility(some, offered, rng)
        elif not np.isfinite(self.utility).any():
            silent = set(keys(near.unit[best]))
            is_silent = np.array([key in silent for key in keys(near.unit)])
            found = np.where(is_silent, -np.inf, utility)
            if not np.isfinite(found).any():
                return utility
        return found

    def _near(self) -> Near:
        """Points that may be proposed."""
        rows, policy, history = self.rows, self.policy, self.history
        space, function = rows.space, policy.function
        order = np.lexsort((history.cost, ~self.model.feasible))
        centres = history.done.parameters[order[:INCUMBENTS]]
        if function is not None:
            best = np.argsort(-self.utility, kind="stable")[:CENTRES]
            best = best[np.isfinite(self.utility[best])]
            centres = np.vstack([rows.parameters[rows.numbers[best]], centres])
        rng = policy.rng(Purpose.OFF_GRID, self.own_turn)
        count = policy.options.off_grid
        near = nearby(space.pinned(history.fixed), centres, count, rng)
        unit, taken = space.unit(near), space.unit(history.taken)
        centres = space.unit(centres)
        new = not_among(unit, taken) & ~_are_rows(rows, unit)
        if function is not None:
            features = call_features(function, near, len(rows.feature_names))
            may_be = np.asarray(~np.isnan(features).any(axis=1))
            points = points_of(rows, policy.options.kernel, near, features)
        else:
            features = np.full((len(near), len(rows.feature_names)), np.nan)
            may_be = not_near(unit, taken)
            between = rows.between(self.model.ensemble)
            points = Points.of(between.at(self.known.features, unit, centres), unit)
        if (new & may_be).any() or np.isfinite(self.utility).any():
            new = new & may_be
        elif function is not None:
            # Nothing new is left: a point whose features are known.
            new = may_be
        return Near(
            parameters=near,
            unit=unit,
            features=features,
            points=points,
            new=new,
            centres=centres,
        )


def most_promising(parameters: Floats, utility: Floats, count: int) -> Whole:
    """Places of the most useful of different points [k, d], by their utility, [k]; so many."""
    order = np.argsort(-utility, kind="stable")
    order = order[np.isfinite(utility[order])]
    # Of integers and choices many points are the same.
    _, first = np.unique(parameters[order], axis=0, return_index=True)
    return order[np.sort(first)[:count]]


def _are_rows(rows: Rows, unit: Floats) -> Mask:
    """Which points are rows, [k]: these are proposed as such, or not at all."""
    known = once(rows, "keys", lambda: set(keys(rows.space.unit(rows.parameters))))
    return np.array([key in known for key in keys(unit)], dtype=bool)
