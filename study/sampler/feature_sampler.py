"""A sampler for those who know which of their candidates are alike.

A Gaussian process of cost over features (of a table's rows, or of any point by a function), over
the parameters themselves, or over both, says what each candidate may cost; an acquisition function
chooses among them. This file is the sampler's contract with Optuna and nothing else: `source`
makes the choice, `history` reads the study.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from study.sampler.candidate_table import CandidateTable
from study.sampler.constraints import (
    ConstraintsFunction,
    feasibility_with,
    store_constraints,
)
from study.sampler.description import call_text
from study.sampler.feature_function import Features
from study.sampler.options import Options
from study.sampler.random_sampler import ReproducibleRandomSampler, new_seed
from study.sampler.sources import new_source

STARTUP_TRIALS = 3  # at random before the first fit


class FeatureKernelSampler(BaseSampler):
    """Bayesian optimisation with a kernel over features computed beforehand.

    Three forms, by `features`:

    - a `CandidateTable` (`study.FeatureTable` is one): a trial is a row of the table that no trial
      has taken, named by the user attribute `row`; with `feature_function` and `off_grid`, also a
      point near the best rows;
    - a function, params [n, d] -> features [n, k]: a trial is any point of the space;
    - None: a Gaussian process over the parameters themselves, the usual baseline.

    The model, y(x) = m(x) + f(x) + noise, with y the (transformed) cost in standard units:

        f ~ GP(0, k(x, x')),   k = s^2 exp(-r^2 / 2) or s^2 (1 + sqrt5 r + 5/3 r^2) exp(-sqrt5 r),
        r^2 = sum_j (phi_j(x) - phi_j(x'))^2 / l_j^2

    over standardised features phi [k], over parameters in the unit cube, or both. s, l and the
    noise maximise the marginal likelihood times a prior (`study.sampler.kernels`). Trials running
    elsewhere are conditioned on as if they had shown what is expected of them.

    What it promises: everything is recomputed from the study's trials, and each draw is seeded by
    the seed and the trial, so a resumed study or another process proposes the same. FAIL and PRUNED
    trials are not learned from; infinite values count as the worst or best finite one.

    Args:
        features: see above. A function gets its columns in the order of `space` or, without it, of
            the names; logarithmic parameters as they are, categorical ones as indices of choices.
        seed: of all draws; None takes one from the machine's entropy.
        n_startup_trials: at random before the first fit, at least 1; with a prior, drawn from it.
        kernel: "rbf", one length scale for all features (the paper's, with one feature); "rbf_ard"
            and "matern_ard" (5/2), one length scale a feature; "euclidean", over the parameters, as
            Hvarfner, Hellsten, Nardi 2024; "sum" and "product" of "rbf_ard" and "euclidean";
            "alternate", "rbf_ard" in even trials and "euclidean" in odd ones: a feature that
            misleads then costs half the trials at most. Default "rbf"; without features
            "euclidean", and no other.
        mean: "constant"; "linear" in the features, slopes learned (a simulated outcome is a good
            guess of the real one, up to scale).
        acquisition: "ei", expected improvement (Jones, Schonlau, Welch 1998); "log_ei", its
            logarithm, which tells candidates apart where EI underflows (Ament et al. 2023); "ucb",
            confidence bound; "thompson", the best of one draw from the posterior.
        exploration: of "ucb", standard deviations below the mean.
        prior: a feature whose high values are thought good; with a minus before its name, its low
            ones. Acquisition is multiplied by rank(feature)^(prior_weight / n), rank being the
            share of candidates that are no better, n the trials finished: what was thought fades
            (piBO, Hvarfner et al. 2022).
        prior_weight: of the prior; the number of trials at which it weighs as its rank.
        mismatch: user attribute under which finished trials report the k features that they really
            showed, as a list (or a number, for one). A second process models simulated minus shown
            over the parameters, and corrects candidates near those trials.
        feasibility: "constraints" (what `trial.set_constraint` was told), or a boolean user
            attribute that is true where a trial failed, such as "fell". Acquisition is multiplied
            by the probability of staying feasible.
        cost_transform: "none"; "rank" (normal scores) or "log", for costs with cliffs.
        off_grid: with a function, points near the best ones that are added to the candidates of
            each trial.
        feature_function: for a table, features of points off it, in the table's order and units.
        n_candidates: points drawn over the whole space a trial, in the forms without a table.
        space: what the study suggests: distributions by name. None takes those that all finished
            trials share, the first trial being random. A table knows its own.
        refit_every: hyper-parameters are fitted anew after so many finished trials, kept between.
        fast: 32-bit posterior, right to 1e-4 of the prior's scale; False: 64-bit.
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
            samplers take it; the same as `feasibility="constraints"`.

    Raises:
        InputError: an option that cannot be used; in a trial (strict), before its objective has
            all parameters: names or ranges of the study that do not fit the table or the space,
            values enqueued that no row has, or a function that raises or returns other than finite
            [n, k]. At a trial's end: it has not suggested all of the table (strict), or what
            `constraints_func` returned.
        TableExhaustedError: in a trial, when no row is left (strict).
        ValueError: in a trial of a study with several objectives.
    """

    def __init__(
        self,
        features: CandidateTable | Features | None = None,
        *,
        seed: int | None = None,
        n_startup_trials: int = STARTUP_TRIALS,
        kernel: str | None = None,
        mean: str = "constant",
        acquisition: str = "log_ei",
        exploration: float = 2.0,
        prior: str | None = None,
        prior_weight: float = 10.0,
        mismatch: str | None = None,
        feasibility: str | None = None,
        cost_transform: str = "none",
        off_grid: int = 0,
        feature_function: Features | None = None,
        n_candidates: int = 2048,
        space: Mapping[str, BaseDistribution] | None = None,
        refit_every: int = 1,
        fast: bool = True,
        strict: bool = True,
        extra_parameters: Collection[str] = (),
        independent_sampler: BaseSampler | None = None,
        nearest: float | None = None,
        constraints_func: ConstraintsFunction | None = None,
    ) -> None:
        """Check the options; nothing is computed yet."""
        given = dict(locals())
        options = Options(
            kernel=kernel or ("euclidean" if features is None else "rbf"),
            mean=mean,
            acquisition=acquisition,
            exploration=exploration,
            prior=prior,
            prior_weight=prior_weight,
            mismatch=mismatch,
            feasibility=feasibility_with(constraints_func, feasibility),
            cost_transform=cost_transform,
            off_grid=off_grid,
            n_candidates=n_candidates,
            n_startup_trials=n_startup_trials,
            refit_every=refit_every,
            fast=fast,
            strict=strict,
            extra_parameters=frozenset(extra_parameters),
            nearest=nearest,
            space=None if space is None else dict(space),
        )
        self._seed = new_seed() if seed is None else seed
        self._independent = independent_sampler or ReproducibleRandomSampler(seed=self._seed)
        self._source = new_source(
            features, feature_function, options, self._seed, self._independent
        )
        self._constraints_func = constraints_func
        self._call = call_text(FeatureKernelSampler.__init__, given | {"seed": self._seed})

    def __repr__(self) -> str:
        """A call that makes one like it: what it was given, and its seed."""
        return f"{type(self).__name__}({self._call})"

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
