"""What the trials of a study have shown so far, and what this decides about the model.

Costs in worlds are a model before any trial (`study.sampler.worlds`). How far a study
believes it, and where its next trial goes, depends on what its trials have shown. A study
comes to these decisions in this order:

| decision | if so |
|---|---|
| `follows_ranking` | the next trial is the best row by its mean over the worlds |
| `only_falls` | failures may be chance: their noise is expected to be large |
| `is_lost` | which world the robot is like counts little; every other trial goes anywhere |
| `noise` | a success among failures is none |
| `successes` | those that succeeded have a process of their own, a hurdle's second part |
| `shuns_failures` | what is likelier to fail comes after all else |
| `is_familiar` | costs count in units of the trials, no longer of the table |
| `rows_fail` | rows are left for points near the trials |

Beside features without worlds there is one: `has_stalled`.

Costs *jump* where they are no smooth function of the parameters, as where walkers fall. To
ask whether they do takes long, once a table, so it is asked last.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.covariance import (
    DOUBTED,
    FALL_NOISE,
    FEW_WORLDS,
    SUCCESS_NOISE,
    WORLD,
    WORLD_NOISE,
    Constant,
    GuessError,
)
from study.sampler.history import OFF_TABLE
from study.sampler.similarity import Relation
from study.sampler.transforms import Points
from study.sampler.unlike import Unlike, unlike
from study.sampler.worlds import Ensemble

PATIENCE = 3  # trials without a better cost
RANKED = 3
# Of one world, while all of them fail: its ranking is all that it tells.
RANKED_OF_ONE = 6
# Trials that all failed, from which on a table that tells little is doubted: of 50 Walker2d
# in four worlds 32 in place of 25 then walked within ten trials. Of six trials, measured
# before: 173 of 180 Ants in place of 162 within 15, and harm on a walker's table, which tells
# something (20 walkers within 12 trials became 13).
HOPELESS = 3
# Trials, from which on smooth costs, or those of successes, are in units of the trials. From
# 3 on, a robot like the worlds lost what they tell of it; from 8 on none did, and others
# gained as much.
FAMILIAR = 8
# Successes, from which on they have a process of their own, where the worlds' hardly differ or
# tell little: until then rows all over the table are tried. From three on, a gentle ramp lost
# (15:32 after 30 trials).
FEW_SUCCESSES = 4
# Rows without success, after one: who is like no world leaves the table. With three of them
# a robot on ramps down left it too early.
ROWS_TRIED = 5


@dataclass(eq=False, kw_only=True)
class Evidence:
    """Trials of a study, what was known before them, and what both decide.

    Attributes:
        trials: the n finished ones.
        rows: of a table that these were, OFF_TABLE off it, [n].
        costs: what these showed, lower is better, finite, [n].
        limits: c constraints of each, kept where <= 0, NaN where unknown, [n, c].
        limits_elsewhere: those of e trials of other studies, [e, c]; None: there are none.
        ensemble: simulated worlds, whose mean cost is expected, or the likeness of a
            pool; None: neither.
        success: cost up to which a trial has succeeded, or what parts the costs of all
            worlds (`Ensemble.parting`); None: there is no such cost.
        off_grid: whether points between the rows of a table are candidates, too.
        familiar: the answer to `is_familiar`; None: trials and table decide.
    """

    trials: Points
    rows: Whole
    costs: Floats
    limits: Floats
    limits_elsewhere: Floats | None = None
    ensemble: Relation | None = None
    success: float | None = None
    off_grid: bool = False
    familiar: bool | None = None

    @cached_property
    def feasible(self) -> Mask:
        """Trials that kept all their limits, [n]."""
        return np.asarray(~(self.limits > 0).any(axis=1))

    @cached_property
    def succeeded(self) -> Mask:
        """Those of them that cost no more than a success, if there is one, [n]."""
        if self.success is None:
            return self.feasible
        return np.asarray(self.feasible & (self.costs <= self.success))

    @property
    def told_limits(self) -> Floats:
        """Constraints of trials elsewhere and of those here, [e + n, c]."""
        if self.limits_elsewhere is None:
            return self.limits
        return np.vstack([self.limits_elsewhere, self.limits])

    @property
    def has_stalled(self) -> bool:
        """Whether the best of the trials that kept their limits is older than `PATIENCE` ones.

        Features are followed while they succeed. The likelihood cannot tell a feature that
        follows the cost everywhere from one that follows it everywhere but at its best;
        success can. So after that every other trial is left to the parameters alone, until
        one of either kind is better than all before (win-stay, lose-shift: Robbins 1952).
        From then on a feature that misleads costs half the trials, as where the two take
        turns (Antonova et al. 2018).
        """
        kept = self.costs[self.feasible]
        return len(kept) > 0 and len(kept) - 1 - int(kept.argmin()) >= PATIENCE

    @property
    def follows_ranking(self) -> bool:
        """Whether the next trial is one of the ranking's, by mean costs in worlds.

        Of smooth costs, or of one world, the first `RANKED` are: they tell how far the robot
        is from all worlds. Of others the first trial tells enough. But if it failed where a
        success is to be had, they are, too: two falls do not yet tell which worlds a robot
        is like. And where few worlds tell nothing of points between the rows, a success is
        no reason to leave the rows for these. One world's ranking is all that it tells:
        until a trial succeeds, or breaks a limit, it goes on, up to `RANKED_OF_ONE` ones.
        """
        worlds, count = self.ensemble, len(self.costs)
        assert isinstance(worlds, Ensemble)
        is_alone = len(worlds.names) == 1
        if count >= RANKED:
            # No ranking minds limits.
            has_broken = bool((self.told_limits > 0).any())
            goes_on = is_alone and count < RANKED_OF_ONE and not has_broken
            return goes_on and self.only_falls
        has_failed = self.success is not None and not self.succeeded.any()
        if has_failed or is_alone or worlds.is_smooth:
            return True
        are_few = len(worlds.names) < FEW_WORLDS
        return self.off_grid and are_few and worlds.guess_error is not None

    @property
    def only_falls(self) -> bool:
        """Whether all trials have failed, where some world has a success, and costs jump."""
        worlds, success = self.of_table, self.success
        if success is None or worlds is None or self.succeeded.any():
            return False
        return worlds.reaches(success) and not self.is_smooth

    @cached_property
    def is_lost(self) -> bool:
        """Whether all trials have failed (`only_falls`), on a machine like no world.

        Where the table tells little (`Ensemble.tells_little`), and its rows can be left, so
        many of them need no other sign.
        """
        worlds = self.of_table
        if worlds is None or not self.only_falls:
            return False
        may_leave = self.off_grid and len(self.costs) >= HOPELESS
        return (may_leave and worlds.tells_little) or self.unlike() is not None

    def unlike(self, sign: float = 1.0) -> Unlike | None:
        """What the first trials have against all worlds; costs times `sign` are values."""
        features = self.trials.features
        return unlike(self.ensemble, features, self.costs, self.rows, sign)

    @property
    def successes(self) -> Ensemble | None:
        """What rows cost in the worlds where they succeed, once trials tell what it costs here.

        None before: one success is enough where worlds tell it at once
        (`Ensemble.tells_successes`), elsewhere it takes `FEW_SUCCESSES`.
        """
        worlds = self.of_table
        if worlds is None:
            return None
        few = 1 if worlds.tells_successes else FEW_SUCCESSES
        return None if self.succeeded.sum() < few else worlds.of_successes

    @property
    def shuns_failures(self) -> bool:
        """Whether a hurdle takes what is likelier to fail last.

        A step from a success often fails, and seems to gain much. Rows alone are no such
        steps: where their successes hardly differ, to shun them lost (a gentle ramp 14:23
        after 20 trials), where they lie far apart it won (rough ground 10:0 after five).
        """
        worlds = self.of_table
        return self.off_grid or (worlds is not None and worlds.tells_successes)

    @property
    def rows_fail(self) -> bool:
        """Whether a table is left: after a success its last `ROWS_TRIED` rows have failed.

        A robot is then like no world, and gains by steps from its own trials. The model does
        not see it: where worlds disagree on a row, it may be good again and again.
        """
        if self.success is None or not isinstance(self.ensemble, Ensemble):
            return False
        tried = (self.rows != OFF_TABLE) & (np.cumsum(self.succeeded) > 0)
        last = self.succeeded[tried][-ROWS_TRIED:]
        return len(last) == ROWS_TRIED and not last.any()

    @property
    def of_table(self) -> Ensemble | None:
        """The worlds, where costs count in units of the table, of all its rows in all worlds.

        They do where walkers fall: the table has seen how far a fall is from a walk.
        """
        found = self.ensemble
        if not isinstance(found, Ensemble) or not found.in_costs or self.is_familiar:
            return None
        return found

    @cached_property
    def is_familiar(self) -> bool:
        """Whether trials tell better than the table how far this robot's costs lie apart.

        Of smooth costs a table knows the form, as it does of what successes cost, and
        `FAMILIAR` trials tell how far this robot's lie apart: then they count by
        `log_excess`, in their own standard deviations. That tells costs near the best
        apart, where a robot unlike all worlds differs from them most. Which worlds the
        robot is like then counts as far as trials ask for it (`likeness`).
        """
        found = self.ensemble
        if not isinstance(found, Ensemble) or not found.in_costs:
            return False
        if self.familiar is not None:
            return self.familiar
        if len(self.costs) < FAMILIAR:
            return False  # to ask whether costs are smooth takes long
        return found.is_of_successes or found.is_smooth

    @property
    def is_smooth(self) -> bool:
        """Whether the worlds' costs are a smooth function of the parameters."""
        return isinstance(self.ensemble, Ensemble) and self.ensemble.is_smooth

    @cached_property
    def knows_scale(self) -> bool:
        """Whether anything tells how far costs lie apart: the table's, or trials that differ."""
        if self.of_table is not None:
            return self.of_table.varies
        return bool(self.costs.min() < self.costs.max())

    @property
    def likeness(self) -> Constant:
        """What is expected of how much it counts which world the robot is like."""
        return DOUBTED if self.is_lost or self.is_familiar else WORLD

    @property
    def noise(self) -> Constant:
        """What is expected of the noise of costs, beside worlds."""
        if self.only_falls:
            return FALL_NOISE
        if self.success is None or self.of_table is None or self.is_smooth:
            return WORLD_NOISE
        return SUCCESS_NOISE if self.succeeded.any() else WORLD_NOISE

    @property
    def guess_error(self) -> GuessError | None:
        """What the table's guess between its rows may be off by, in the unit of costs."""
        if self.of_table is None or not self.off_grid:
            return None
        return self.of_table.guess_error
