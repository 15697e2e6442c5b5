"""Samplers for candidates of which some are known to be alike: the contract with Optuna."""

import inspect
import secrets
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from storage.inputs import checks
from storage.inputs.errors import InputError
from study.sampler.arrays import Mask
from study.sampler.covariance import KERNELS, SIMILARITY, WITH_WORLDS
from study.sampler.diagnostics import Likeness, Worth, likeness_of, worth_of
from study.sampler.draws import ReproducibleRandomSampler
from study.sampler.policy import Features, Options, one_thread
from study.sampler.prediction import Best, Prediction, best_of
from study.sampler.risk import AllowedRisk, allowed_risk
from study.sampler.space_policy import SpacePolicy
from study.sampler.table import FeatureTable
from study.sampler.table_policy import TablePolicy
from study.sampler.worlds import Ensemble

MOST_OFF_GRID = 1_000_000
OFF_GRID = 1500  # points near the best trials, where worlds say what rows cost
# Antonova, Rai, Atkeson 2016; options that are not named keep their defaults.
PAPER: dict[str, Any] = {"kernel": "rbf"}


_MASK = checks.that(
    lambda value: (
        isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype == bool
    ),
    "an array of flags, one a row",
)


class FeatureKernelSampler(BaseSampler):
    """Bayesian optimisation with a kernel over features computed beforehand.

    Three forms, by `features`:

    - a `FeatureTable`: a trial is a row of the table that no trial has taken, named by
      the user attribute `row`; with `feature_function` and `off_grid`, also a point
      near the best rows; with outcomes in simulated worlds, also a point near the best
      trials; these may be any ranking of the rows, in units of its own;
    - a function, params [n, d] -> features [n, k]: a trial is any point of the space;
    - None: a Gaussian process over the parameters themselves, the usual baseline.

    The model, with y the cost and phi the features, in standard units (phi: normal
    scores of their ranks; y: the logarithm of the excess over the least cost), u the
    parameters in the unit cube:

        y(x) = w^T phi(x) + f(phi(x)) + g(u(x)) + noise,
        w ~ N(0, v I),  f ~ GP(0, s^2 exp(-sum_j (phi_j - phi'_j)^2 / 2 l_j^2)),
        g ~ GP(0, t^2 exp(-|u - u'|^2 / 2 L^2))

    On a table with outcomes in worlds, costs are in the table's units, but for smooth
    ones, which soon are in those of the trials; and the mean and covariance of the rows
    over the worlds are a part of the model (`study.sampler.worlds`). On a pool of which
    a similarity is known, that alone is the model (`study.sampler.similarity`).

    v, s, t, the length scales and the noise are learned (`study.sampler.covariance`,
    `study.sampler.gp`). Once no
    trial has been better than all before for some time, every other one is left to g
    alone (`study.sampler.transforms`). Trials running elsewhere are conditioned on as
    if they had shown what is expected of them. Constraints are those that the objective
    names by `trial.set_constraint(key, value)`, feasible where the value is <= 0:
    improvement is multiplied by the probability that all are kept (Gelbart, Snoek,
    Adams 2014).

    Of a study with several objectives each trial has weights of its own
    (`study.sampler.goals`).

    What it promises: everything is recomputed from the study's trials, and each draw is
    seeded by the seed and the trial, so a resumed study or another process proposes the
    same. FAIL and PRUNED trials are not learned from; infinite values are worse, or
    better, than all finite ones.

    Args:
        features: see above. A function gets its columns in the order of `space` or,
            without it, of the names; logarithmic parameters as they are, categorical
            ones as indices of choices.
        seed: of all draws; None takes one from the machine's entropy.
        kernel: None: the model above with features, "euclidean" without. "additive":
            the model above; a kernel that is named leaves outcomes out. "rbf": f alone,
            of features as they are (standardised), one length scale for all and the
            cost as it is, the paper's. "euclidean": over the parameters alone, Matern's
            covariance of order 5/2, a length scale each. All but the first start with
            three random trials.
        feature_function: for a table, features of points off it, in the table's order
            and units; with outcomes in worlds these, [n, w], of points that are
            simulated, a column a world (`study.worlds_function`). Of each trial the most
            promising points off the table are then simulated, in place of guessed from
            the rows. What it returns of a point may not depend on other points.
        off_grid: with such a function, the number of points near the best ones that are
            added to the candidates of each trial; by default none. With outcomes in
            worlds, of points near the best trials, by default 1,500; 0: rows alone are
            proposed.
        space: what the study suggests: distributions by name. None takes those that all
            finished trials share, the first trial being random. A table has its own.
        strict: True: what does not fit is an error before the objective has its
            parameters; False: the independent sampler takes over, with one warning.
        extra_parameters: names that the study suggests before or between those of the
            table, and that the table does not have (they go to the independent
            sampler). Those suggested after the table's need not be named.
        independent_sampler: for parameters that the features do not cover; by default
            uniform.
        success: the value of the study from which on a trial has succeeded: at most
            this, or at least, where values are maximised. Until one has, the candidate
            that most likely succeeds comes next (with costs in worlds after the three
            best rows by their mean; on a machine like no world plain Bayesian
            optimisation by turns with it), then that of the largest expected improvement;
            where costs jump, and successes tell what one costs, of this times the chance
            of success. None: improvement alone counts; or where costs jump and are two
            groups, what parts these takes its place (`Ensemble.parting`).
        allowed: which rows of a table may be proposed, [n]; None: all. Points off it
            are not looked at then.
        limits_of: trials of other studies over the same table, whose constraints alone
            are learned: what broke a limit there is expected to break it here.
        allowed_risk: proposals keep to candidates whose chance to break a limit is at
            most this, by the limit's name, or one number for each limit. The table's
            `limits` tell of it, or trials do (`trial.set_constraint`).

    Raises:
        InputError: an option that cannot be used; in a trial (strict), before its
            objective has all parameters: names or ranges of the study that do not fit
            the table or the space, values enqueued that no row has, or a function that
            raises or returns other than finite [n, k]. At a trial's end: it has not
            suggested all of the table (strict).
        RiskError: in a trial, when no candidate that is left has a risk as small as
            `allowed_risk`, or nothing tells of it.
        TableExhaustedError: in a trial, when no row is left (strict).
        ValueError: `best`, `predict` or `worth` of a study with several objectives.
    """

    @checks.checked(
        seed=checks.optional(checks.whole(0, checks.LARGEST_SEED)),
        kernel=checks.optional(checks.text),
        feature_function=checks.optional(checks.function),
        off_grid=checks.optional(checks.whole(0, MOST_OFF_GRID)),
        space=checks.optional(checks.by_name(checks.instance(BaseDistribution))),
        strict=checks.flag,
        extra_parameters=checks.each(checks.text),
        independent_sampler=checks.optional(checks.instance(BaseSampler)),
        success=checks.optional(checks.number()),
        allowed=checks.optional(_MASK),
        limits_of=checks.each(checks.instance(FrozenTrial)),
        allowed_risk=checks.optional(allowed_risk),
    )
    def __init__(
        self,
        features: FeatureTable | Features | None = None,
        *,
        seed: int | None = None,
        kernel: str | None = None,
        feature_function: Features | None = None,
        off_grid: int | None = None,
        space: Mapping[str, BaseDistribution] | None = None,
        strict: bool = True,
        extra_parameters: Collection[str] = (),
        independent_sampler: BaseSampler | None = None,
        success: float | None = None,
        allowed: Mask | None = None,
        limits_of: Sequence[FrozenTrial] = (),
        allowed_risk: AllowedRisk | None = None,
    ) -> None:
        self._kernel = kernel or ("euclidean" if features is None else "additive")
        if self._kernel not in KERNELS:
            raise InputError("kernel", self._kernel, f"one of {', '.join(KERNELS)}")
        chosen = KERNELS[self._kernel]
        if isinstance(features, FeatureTable) and kernel is None:
            if features.rows.alike is not None:
                chosen = SIMILARITY
            elif features.rows.worlds is not None:
                chosen = WITH_WORLDS
        near = OFF_GRID if chosen == WITH_WORLDS and allowed is None else 0
        options = Options(
            kernel=chosen,
            off_grid=near if off_grid is None else off_grid,
            space=space,
            extra_parameters=frozenset(extra_parameters),
            strict=strict,
            success=success,
            allowed=allowed,
            limits_of=tuple(limits_of),
            allowed_risk=allowed_risk,
        )
        seed = secrets.randbits(64) if seed is None else seed
        self._independent = independent_sampler or ReproducibleRandomSampler(seed=seed)
        self._policy: TablePolicy | SpacePolicy
        if isinstance(features, FeatureTable):
            _require_sense_of_table(features, feature_function, options, self._kernel)
            self._policy = TablePolicy(
                features, feature_function, options, seed, self._independent
            )
        else:
            _require_sense_of_space(features, feature_function, options, self._kernel)
            self._policy = SpacePolicy(features, options, seed, self._independent)
        shown = {
            "features": features,
            "seed": seed,
            "kernel": kernel,
            "feature_function": feature_function,
            "off_grid": off_grid,
            "space": space,
            "strict": strict,
            "extra_parameters": extra_parameters,
            "independent_sampler": independent_sampler,
            "success": success,
            "allowed": allowed,
            "limits_of": limits_of,
            "allowed_risk": allowed_risk,
        }
        self._call = _call_text(shown)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._call})"

    @property
    def has_features(self) -> bool:
        """Whether candidates are compared by features, so that `worth` has something to report."""
        return self._policy.options.kernel.of_features

    @property
    def errors(self) -> dict[str, list[float]]:
        """How far off the last predictions were, by a digest of what they follow from.

        They take most of the time of a `predict` after many trials. Another process that
        is given them does not compute them again, if it has the same table and options.
        """
        known = self._policy.past_errors
        return {key: [*map(float, found)] for key, found in known.items()}

    @errors.setter
    def errors(self, known: Mapping[str, Sequence[float]]) -> None:
        found = {key: np.array(errors, float) for key, errors in known.items()}
        self._policy.past_errors = found

    @checks.checked(study=checks.instance(optuna.Study))
    def worth(self, study: optuna.Study) -> Worth | Likeness:
        """The importance of the features in the finished trials of a study, which is not changed.

        With outcomes in worlds it is which of these the trials are like.

        It can be printed, or shown in the dashboard: `optuna_dashboard.save_note(study,
        sampler.worth(study).markdown())`.

        Args:
            study: of these parameters; its sampler may be another.

        Raises:
            InputError: there are no features, or their function raises.
        """
        self._raise_error_if_multi_objective(study)
        if not self.has_features:
            raise InputError(
                "kernel",
                self._kernel,
                "one that uses features, or there is nothing to report",
            )
        with one_thread():
            present = self._policy.present(study)
            if present is not None and isinstance(present.model.ensemble, Ensemble):
                return likeness_of(present.model, present.model.ensemble.names)
            maximised = study.direction is StudyDirection.MAXIMIZE
            return worth_of(present, maximised=maximised)

    @checks.checked(study=checks.instance(optuna.Study))
    def best(self, study: optuna.Study) -> Best:
        """The trial of the best reading, repeats as their mean, and what the model makes of it.

        Args:
            study: of these parameters, with a finished trial; it is not changed.

        Raises:
            InputError: no finished trial can be learned from.
        """
        self._raise_error_if_multi_objective(study)
        with one_thread():
            present = self._policy.present(study)
            if present is None or not present.trials:
                allowed = "a study with a finished trial of these parameters"
                raise InputError("study", study.study_name, allowed)
            return best_of(
                present, maximised=study.direction is StudyDirection.MAXIMIZE
            )

    @checks.checked(
        study=checks.instance(optuna.Study),
        params=checks.optional(checks.each(checks.by_name(checks.anything))),
    )
    def predict(
        self, study: optuna.Study, params: Sequence[Mapping[str, Any]] | None = None
    ) -> Prediction:
        """What to expect of rows of the table that may be proposed, or of given parameters.

        Trials that run tell nothing, as those that failed.

        Args:
            study: of these parameters; it is not changed, and need not have a trial.
            params: parameters by name, m times; None: the rows.

        Raises:
            InputError: the sampler has no table, or parameters that it cannot have.
        """
        self._raise_error_if_multi_objective(study)
        if not isinstance(self._policy, TablePolicy):
            raise InputError(
                "features", "no table", "a FeatureTable: its rows are predicted"
            )
        with one_thread():
            return self._policy.predict(study, params)

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The table's parameters, or the space."""
        return self._policy.search_space(study, trial)

    def sample_relative(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        search_space: dict[str, BaseDistribution],
    ) -> dict[str, Any]:
        """The parameters of one candidate."""
        return self._policy.propose(study, trial, search_space)

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Parameters that the features do not cover go to the independent sampler."""
        return self._policy.propose_one(study, trial, param_name, param_distribution)

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Note the row of a trial that was enqueued; passed on to the independent sampler."""
        self._policy.before(study, trial)
        self._independent.before_trial(study, trial)

    def after_trial(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        state: TrialState,
        values: Sequence[float] | None,
    ) -> None:
        """Correct the notes of the trial; passed on to the independent sampler first.

        Raises:
            InputError: the objective has not suggested all of a table (strict). The
                trial's value is stored nevertheless.
        """
        self._independent.after_trial(study, trial, state, values)
        self._policy.after(study, trial, is_complete=state is TrialState.COMPLETE)

    def reseed_rng(self) -> None:
        """Reseed the independent sampler; proposals differ by the trials that take them."""
        self._independent.reseed_rng()


class DoGSampler(FeatureKernelSampler):
    """The paper's sampler: a squared exponential on the table's score, expected improvement.

    Antonova, Rai, Atkeson 2016: two parameter sets are alike when their scores are,

        k(x, x') = exp(-(phi(x) - phi(x'))^2 / 2),

    the score phi of each having been computed beforehand, on a grid from which
    candidates come. Scale, length scale and noise are learned; everything else is as in
    the paper.

    Args:
        table: parameter sets and their score (or scores, with one length scale for
            all).
        seed: of all draws; None takes one from the machine's entropy.
        **options: of `FeatureKernelSampler`, for what differs from `PAPER`.
    """

    def __init__(
        self, table: FeatureTable, *, seed: int | None = None, **options: Any
    ) -> None:
        super().__init__(table, seed=seed, **PAPER | options)


def _require_sense_of_table(
    table: FeatureTable, function: Features | None, options: Options, kernel: str
) -> None:
    """Refuse options that do not go together with a table."""
    off_grid, related = options.off_grid, options.kernel.related
    if options.kernel == SIMILARITY and function is not None:
        allowed = "none beside a similarity, which does its work"
        raise InputError("feature_function", "given", allowed)
    if options.allowed is not None and options.allowed.shape != (len(table),):
        raise InputError("allowed", "another size", f"[{len(table)}]")
    if off_grid and options.allowed is not None:
        raise InputError("off_grid", off_grid, "0 beside `allowed` rows")
    if off_grid and function is None and not related:
        raise InputError("off_grid", off_grid, "0 without a feature_function")
    if off_grid and options.kernel == SIMILARITY:
        allowed = "0: a similarity knows its rows alone"
        raise InputError("off_grid", off_grid, allowed)
    if options.space is not None:
        raise InputError("space", "given", "none: a table knows its own")
    if options.allowed_risk is not None and not options.strict:
        allowed = "none without strict: the independent sampler knows no risk"
        raise InputError("allowed_risk", options.allowed_risk, allowed)
    if options.kernel.of_features and not related and not table.rows.feature_names:
        allowed = "none, or euclidean: the table has no features"
        raise InputError("kernel", kernel, allowed)


def _require_sense_of_space(
    features: Features | None, function: Features | None, options: Options, kernel: str
) -> None:
    """Refuse options that do not go together without a table."""
    if options.allowed is not None:
        raise InputError("allowed", "given", "none without a table")
    if options.limits_of:
        raise InputError("limits_of", "given", "none without a table")
    if options.allowed_risk is not None:
        raise InputError("allowed_risk", options.allowed_risk, "none without a table")
    if function is not None:
        allowed = "none: only a table needs it beside `features`"
        raise InputError("feature_function", "given", allowed)
    if features is not None and not callable(features):
        name = type(features).__name__
        raise InputError("features", name, "a FeatureTable, a function, or None")
    if features is None and options.kernel.of_features:
        raise InputError("kernel", kernel, "euclidean: there are no features")
    if features is None and options.off_grid:
        allowed = "0: points are off any grid without features"
        raise InputError("off_grid", options.off_grid, allowed)


def _call_text(given: Mapping[str, Any]) -> str:
    """The arguments of `FeatureKernelSampler` that are not its defaults, as in a call."""
    parts = []
    parameters = inspect.signature(FeatureKernelSampler).parameters
    for name, value in given.items():
        default = parameters[name].default
        is_equal = type(value) is type(default) and bool(value == default)
        if value is default or is_equal:
            continue
        shown = repr(value)
        if isinstance(value, BaseSampler):
            shown = str(value)
        elif inspect.isroutine(value):
            shown = value.__qualname__  # an address would say less
        parts.append(shown if name == "features" else f"{name}={shown}")
    return ", ".join(parts)
