"""How a study suggests the parameters of a table, as far as its trials have shown."""

import math
from collections.abc import Iterable, Mapping

import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution

from study.sampler.rows import Rows
from study.sampler.space import Space


class Inferred(dict[str, BaseDistribution]):
    """The search space of a table, as it is given to Optuna: distributions by name.

    Optuna holds what is proposed at once to these distributions, and a study that suggests another
    scale, kind, or order of choices fails with them. Values are therefore handed out one by one
    where the space is this one; who asks for another space gets values of that.
    """


def suggested_so_far(names: Iterable[str], study: optuna.Study) -> dict[str, BaseDistribution]:
    """Distributions by name, of the latest trial that has each; names that none has are left out.

    Within a study Optuna holds a parameter to one kind of distribution, one scale, and, of a
    categorical, one list of choices.
    """
    wanted, found = set(names), dict[str, BaseDistribution]()
    for trial in reversed(study.get_trials(deepcopy=False)):
        if not wanted:
            break
        for name in wanted & trial.distributions.keys():
            found[name] = trial.distributions[name]
            wanted.discard(name)
    return found


def as_suggested_rows(rows: Rows, suggested: Mapping[str, BaseDistribution]) -> Rows:
    """The rows with a logarithmic scale for what a study suggests on one.

    It is the scale of the kernels that look at parameters, and of points near the rows. A scale or
    step that the table was given stays. Rows that the study does not hold stay as they are, too.

    Args:
        rows: of the table.
        suggested: distributions by name, of all parameters or some.
    """
    distributions = list(rows.space.distributions)
    for column, own in enumerate(distributions):
        theirs = suggested.get(rows.names[column])
        if theirs is not None and _on_logarithms(theirs) and rows.outside(column, theirs) is None:
            distributions[column] = _logarithmic(own, theirs)
    if all(new is old for new, old in zip(distributions, rows.space.distributions, strict=True)):
        return rows
    return rows.with_space(Space(rows.names, tuple(distributions)))


def _on_logarithms(distribution: BaseDistribution) -> bool:
    """Whether its scale is logarithmic."""
    return bool(getattr(distribution, "log", False))


def _logarithmic(own: BaseDistribution, theirs: BaseDistribution) -> BaseDistribution:
    """A numeric distribution without steps on a logarithmic scale, where both ranges overlap."""
    assert isinstance(theirs, FloatDistribution | IntDistribution)
    if isinstance(own, FloatDistribution) and own.step is None and not own.log:
        return FloatDistribution(max(own.low, theirs.low), min(own.high, theirs.high), log=True)
    if isinstance(own, IntDistribution) and own.step == 1 and not own.log:
        low, high = math.ceil(theirs.low), math.floor(theirs.high)
        return IntDistribution(max(own.low, low), min(own.high, high), log=True)
    return own
