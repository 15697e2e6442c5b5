"""Whether a table fits what a study suggests, as far as its trials show."""

from collections.abc import Mapping

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution
from optuna.trial import FrozenTrial, TrialState

from study.sampler.rows import Rows
from taichi_nmm.errors import InputError


def shown_misfit(
    rows: Rows, suggested: Mapping[str, BaseDistribution], study: optuna.Study
) -> InputError | None:
    """What trials have shown against a table that need not fit; None if nothing.

    Args:
        rows: of the table.
        suggested: how the study is known to suggest its parameters, or some of them.
        study: whose latest finished trial may have suggested some of them only.
    """
    for column, name in enumerate(rows.names):
        error = distribution_misfit(rows, column, suggested[name]) if name in suggested else None
        if error is not None:
            return error
    trial = _latest(study)
    some = trial is not None and any(name in trial.params for name in rows.names)
    return not_suggested(rows, trial) if trial is not None and some else None


def proves_fit(rows: Rows, study: optuna.Study) -> bool:
    """Whether the latest finished trial suggested all parameters of the table, and holds them."""
    trial = _latest(study)
    return trial is not None and all(
        name in trial.distributions
        and distribution_misfit(rows, column, trial.distributions[name]) is None
        for column, name in enumerate(rows.names)
    )


def not_suggested(rows: Rows, trial: FrozenTrial) -> InputError | None:
    """What a trial without some parameter of the table says against it; None if it has all."""
    for name in rows.names:
        if name not in trial.params:
            allowed = f"an objective that suggests all of {', '.join(rows.names)}"
            return InputError(name, f"not suggested in trial {trial.number}", allowed)
    return None


def distribution_misfit(rows: Rows, column: int, suggested: BaseDistribution) -> InputError | None:
    """An error if what is suggested for one parameter leaves rows out; None if it holds all.

    Kind, scale and order of choices may be others than the table's: its values count.
    """
    outside = rows.outside(column, suggested)
    if outside is None:
        return None
    name, own = rows.names[column], rows.space.distributions[column]
    value = rows.as_parameters(outside)[name]
    what = (
        "choices that hold"
        if isinstance(suggested, CategoricalDistribution)
        else "a range that holds"
    )
    allowed = f"{what} all rows: row {outside} has {value!r} (the table: {own}, or as space= says)"
    return InputError(name, str(suggested), allowed)


def _latest(study: optuna.Study) -> FrozenTrial | None:
    """The finished trial of the highest number."""
    trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return trials[-1] if trials else None
