"""Points off the table: near the best rows and trials, and where these climb to.

What a point would be compared by is told by a function of the user's, or by what the
worlds say of the rows around it (`study.sampler.emulator`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from study.sampler.acquisition import Model
from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.ascent import climbed
from study.sampler.covariance import EUCLIDEAN
from study.sampler.history import History
from study.sampler.policy import Features, Policy, call_features
from study.sampler.rows import Rows
from study.sampler.space import Space, nearby, not_among, not_near
from study.sampler.space_policy import SpacePolicy
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble

CENTRES = 8  # best rows that points with features are near to
INCUMBENTS = 3  # and best trials
CLIMBING_ROWS = 4  # best rows that climb beside worlds
CLIMBING_POINTS = 2  # and best points near the trials
CLIMBING_STEPS = 20  # at most
FIRST_OF_TURNS = 5  # trials, after which every other one is left to the parameters
# Of a range: a point off the table that is nearer to a trial, in every parameter,
# repeats it. With two knobs half of the trials were such repeats; in 16 dimensions none
# is.
REPEAT = 0.01


@dataclass(frozen=True, eq=False)
class Around:
    """Where to look.

    Attributes:
        space: of the parameters, with pins where the user has fixed values.
        incumbents: parameters of the best trials, [c, d].
        taken: parameters of all trials, running ones too, [t, d].
        utility: of the rows that may be proposed, [m]; minus infinity of those that
            are not free.
        count: points to draw.
        rng: of the points.
    """

    space: Space
    incumbents: Floats
    taken: Floats
    utility: Floats
    count: int
    rng: np.random.Generator

    def best_rows(self, count: int) -> Whole:
        """Places of the best free rows among those that may be proposed, at most so many."""
        best = np.argsort(-self.utility, kind="stable")[:count]
        return best[np.isfinite(self.utility[best])]

    def drawn(self, centres: Floats) -> Floats:
        """Points near centres [c, d], [count, d]."""
        return nearby(self.space, centres, self.count, self.rng)


@dataclass(frozen=True, eq=False)
class Off:
    """Points off the table.

    Attributes:
        parameters: [m, d].
        features: of each, as a function of the user's has them, [m, k]; else NaN.
        points: as the model sees them.
        new: which may be taken, [m].
    """

    parameters: Floats
    features: Floats
    points: Points
    new: Mask


def by_function(
    around: Around,
    rows: Rows,
    function: Features,
    seen: Callable[[Floats, Floats], Points],
) -> Off:
    """Points near the best rows and trials, of which the function gives features.

    Args:
        around: where to look.
        rows: of the table.
        function: of the user's.
        seen: how the model sees parameters and features.
    """
    best = rows.numbers[around.best_rows(CENTRES)]
    near = around.drawn(np.vstack([rows.parameters[best], around.incumbents]))
    features = call_features(function, near, rows.features.shape[1])
    known = np.asarray(~np.isnan(features).any(axis=1))
    new = not_among(near, around.taken) & known
    return Off(
        parameters=near,
        features=features,
        points=seen(near, features),
        new=new if new.any() else known,
    )


def beside_worlds(
    around: Around,
    rows: Rows,
    model: Model,
    ensemble: Ensemble,
    rng: np.random.Generator,
) -> Off:
    """The best of points near the trials, and where these and the best rows climb to.

    None repeats a trial, unless no row is left either: repeats are asked for by
    enqueuing them.
    """
    space = around.space
    best = rows.unit[around.best_rows(CLIMBING_ROWS)]
    centres = np.vstack([space.unit(around.incumbents), best])
    chart = rows.emulator(ensemble).around(centres)
    taken = space.unit(around.taken)

    def off(parameters: Floats) -> Off:
        unit = space.unit(parameters)
        new = not_among(parameters, around.taken)
        elsewhere = new & not_near(unit, taken, REPEAT)
        if len(best) or elsewhere.any():
            new = elsewhere
        features = np.full((len(unit), len(rows.feature_names)), np.nan)
        points, _ = chart.placed(unit)
        return Off(parameters=parameters, features=features, points=points, new=new)

    near = off(around.drawn(around.incumbents))
    utility = model.utility(near.points, near.new, rng)
    order = np.argsort(-utility, kind="stable")[:CLIMBING_POINTS]
    starts = np.vstack([near.points.coordinates[order], best])
    ends = climbed(model, chart, starts, space.movable, CLIMBING_STEPS)
    return off(np.vstack([near.parameters[order], space.from_unit(ends)]))


def is_left_to_parameters(model: Model, own_turn: int) -> bool:
    """Whether no world is asked in a trial: in every other one, once some have succeeded.

    What no world knows is learned sooner without them (Antonova et al. 2018).
    """
    is_early = len(model.costs) < FIRST_OF_TURNS or model.seeks_success
    return isinstance(model.ensemble, Ensemble) and own_turn % 2 == 1 and not is_early


def by_parameters(
    policy: Policy, space: Space, history: History, own_turn: int
) -> Floats | None:
    """The point [d] that a policy proposes without its worlds; None where it repeats a trial."""
    options = replace(policy.options, kernel=EUCLIDEAN)
    plain = SpacePolicy(None, options, policy.seed, policy.independent)
    point, _ = plain.best(space.pinned(history.fixed), history, own_turn)
    taken = space.unit(history.taken)
    is_new = not_near(space.unit(point[None]), taken, REPEAT)[0]
    return point if is_new else None
