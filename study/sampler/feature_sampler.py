"""A sampler for those who know which of their candidates are alike.

A Gaussian process of cost over features (of a table's rows, or of any point by a function) and over
the parameters themselves says what each candidate may cost; the one from which most improvement is
expected comes next. This file is the sampler's contract with Optuna and nothing else: `source`
makes the choice, `history` reads the study.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from study.sampler.candidate_table import CandidateTable
from study.sampler.constraints import (
    ConstraintsFunction,
    checked,
    store_constraints,
)
from study.sampler.description import call_text
from study.sampler.diagnostics import Worth, worth_of
from study.sampler.feature_function import Features
from study.sampler.options import Options
from study.sampler.random_sampler import ReproducibleRandomSampler, new_seed
from study.sampler.source import one_thread
from study.sampler.sources import new_source
from taichi_nmm import checks
from taichi_nmm.errors import InputError

DEFAULT_KERNELS = "additive", "euclidean"  # with features, without
MOST_OFF_GRID = 1_000_000


class FeatureKernelSampler(BaseSampler):
    """Bayesian optimisation with a kernel over features computed beforehand.

    Three forms, by `features`:

    - a `CandidateTable` (`study.FeatureTable` is one): a trial is a row of the table that no trial
      has taken, named by the user attribute `row`; with `feature_function` and `off_grid`, also a
      point near the best rows;
    - a function, params [n, d] -> features [n, k]: a trial is any point of the space;
    - None: a Gaussian process over the parameters themselves, the usual baseline.

    The model, with y the cost and phi the features, in standard units (phi: normal scores of their
    ranks; y: the logarithm of the excess over the least cost), u the parameters in the unit cube:

        y(x) = w^T phi(x) + f(phi(x)) + g(u(x)) + noise,
        w ~ N(0, v I),  f ~ GP(0, s^2 exp(-sum_j (phi_j - phi'_j)^2 / 2 l_j^2)),
        g ~ GP(0, t^2 exp(-|u - u'|^2 / 2 L^2))

    v, s, t, the length scales and the noise maximise the marginal likelihood times a prior
    (`study.sampler.gp`): what explains nothing gets no weight. Once no trial has been better
    than all before for some time, every other one is left to g alone
    (`study.sampler.transforms`), so that features that mislead cost half the trials from then on.
    Trials running elsewhere are conditioned on as if they had shown what is expected of them.

    What it promises: everything is recomputed from the study's trials, and each draw is seeded by
    the seed and the trial, so a resumed study or another process proposes the same. FAIL and PRUNED
    trials are not learned from; infinite values count as the worst or best finite one.

    Args:
        features: see above. A function gets its columns in the order of `space` or, without it, of
            the names; logarithmic parameters as they are, categorical ones as indices of choices.
        seed: of all draws; None takes one from the machine's entropy.
        prior: a feature whose high values are thought good; with a minus before its name, its low
            ones. The first three trials are the best rows of that ranking, in its order; then the
            cost is expected to follow it, as far as trials confirm that
            (`study.sampler.transforms.Guess`).
        kernel: None: the model above with features, "euclidean" without. "additive": the model
            above. "rbf": f alone, of features as they are (standardised), one length scale for all
            and the cost as it is, the paper's; "rbf_ard": the same with a length scale a feature.
            "euclidean": over the parameters alone, a length scale each, as Hvarfner, Hellsten,
            Nardi 2024. All but the first start with three random trials, unless there is a prior.
        feature_function: for a table, features of points off it, in the table's order and units.
        off_grid: with such a function, the number of points near the best ones that are added to
            the candidates of each trial.
        space: what the study suggests: distributions by name. None takes those that all finished
            trials share, the first trial being random. A table knows its own.
        strict: True: what does not fit is an error before the objective has its parameters; False:
            the independent sampler takes over, with one warning.
        extra_parameters: names that the study suggests before or between those of the table, and
            that the table does not have (they go to the independent sampler). Those suggested
            after the table's need not be named.
        independent_sampler: for parameters that the features do not cover; by default uniform.
        nearest: of a table: the distance from its nearest row at which a trial off the table (of an
            earlier study, or enqueued) is learned from, with the features of that row. The root
            mean square of the parameters' differences, each as a share of its range (of its
            logarithm, where it is logarithmic; two choices are 1 apart): 0.05 is a twentieth of
            the ranges. None: such trials are ignored, unless there is a `feature_function`.
        constraints_func: of a finished trial, its constraints, feasible where <= 0, as Optuna's own
            samplers take it. `trial.set_constraint` in the objective does the same. Improvement is
            multiplied by the probability that all are kept (Gelbart, Snoek, Adams 2014).

    Raises:
        InputError: an option that cannot be used; in a trial (strict), before its objective has
            all parameters: names or ranges of the study that do not fit the table or the space,
            values enqueued that no row has, or a function that raises or returns other than finite
            [n, k]. At a trial's end: it has not suggested all of the table (strict), or what
            `constraints_func` returned.
        TableExhaustedError: in a trial, when no row is left (strict).
        ValueError: in a trial of a study with several objectives.
    """

    @checks.checked(
        seed=checks.optional(checks.whole(0, checks.LARGEST_SEED)),
        prior=checks.optional(checks.text),
        kernel=checks.optional(checks.text),
        feature_function=checks.optional(checks.function),
        off_grid=checks.whole(0, MOST_OFF_GRID),
        space=checks.optional(checks.by_name(checks.instance(BaseDistribution))),
        strict=checks.flag,
        extra_parameters=checks.each(checks.text),
        independent_sampler=checks.optional(checks.instance(BaseSampler)),
    )
    def __init__(
        self,
        features: CandidateTable | Features | None = None,
        *,
        seed: int | None = None,
        prior: str | None = None,
        kernel: str | None = None,
        feature_function: Features | None = None,
        off_grid: int = 0,
        space: Mapping[str, BaseDistribution] | None = None,
        strict: bool = True,
        extra_parameters: Collection[str] = (),
        independent_sampler: BaseSampler | None = None,
        nearest: float | None = None,
        constraints_func: ConstraintsFunction | None = None,
    ) -> None:
        """Check the options; nothing is computed yet."""
        given = dict(locals())
        options = Options(
            kernel=kernel if kernel is not None else DEFAULT_KERNELS[features is None],
            prior=prior,
            off_grid=off_grid,
            nearest=nearest,
            space=space,
            extra_parameters=frozenset(extra_parameters),
            strict=strict,
        )
        self._seed = new_seed() if seed is None else seed
        self._independent = independent_sampler or ReproducibleRandomSampler(seed=self._seed)
        self._source = new_source(
            features, feature_function, options, self._seed, self._independent
        )
        self._constraints_func = checked(constraints_func)
        self._call = call_text(FeatureKernelSampler.__init__, given | {"seed": self._seed})

    def __repr__(self) -> str:
        """A call that makes one like it: what it was given, and its seed."""
        return f"{type(self).__name__}({self._call})"

    @property
    def has_features(self) -> bool:
        """Whether it takes candidates for alike by features, whose worth can be told."""
        return self._source.options.model.of_features

    @checks.checked(study=checks.instance(optuna.Study))
    def worth(self, study: optuna.Study) -> Worth:
        """What the features are worth, by the finished trials of a study, which stays as it is.

        To be printed, or shown in the dashboard: `optuna_dashboard.save_note(study,
        sampler.worth(study).markdown())`.

        Args:
            study: of these parameters; its sampler may be another.

        Raises:
            InputError: there are no features, or their function raises.
            ValueError: the study has several objectives.
        """
        self._raise_error_if_multi_objective(study)
        if not self.has_features:
            kernel = self._source.options.kernel
            raise InputError("kernel", kernel, "one of features: there are none")
        with one_thread():
            present = self._source.present(study)
            maximised = study.direction is StudyDirection.MAXIMIZE
            return worth_of(present, maximised=maximised)

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """What is proposed at once: the table's parameters, or the space."""
        return self._source.search_space(study, trial)

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The parameters of one candidate."""
        self._raise_error_if_multi_objective(study)
        return self._source.propose(study, trial, search_space)

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Parameters that the features do not cover go to the independent sampler."""
        self._raise_error_if_multi_objective(study)
        return self._source.propose_one(study, trial, param_name, param_distribution)

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Note the row of a trial that was enqueued; passed on to the independent sampler."""
        self._source.before(study, trial)
        self._independent.before_trial(study, trial)

    def after_trial(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        state: TrialState,
        values: Sequence[float] | None,
    ) -> None:
        """Keep what is noted true, and constraints; passed on to the independent sampler first.

        Raises:
            InputError: the objective has not suggested all of a table (strict): with this trial,
                whose value is stored nevertheless, it is known. Or what `constraints_func` says.
        """
        self._independent.after_trial(study, trial, state, values)
        try:
            if self._constraints_func is not None:
                store_constraints(self._constraints_func, study, trial, state)
        finally:
            self._source.after(study, trial, state)

    def reseed_rng(self) -> None:
        """Passed on to the independent sampler; proposals differ by the trials that take them."""
        self._independent.reseed_rng()
