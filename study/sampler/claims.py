"""How workers that share a study come to propose different rows, with no lock between them.

A worker writes the number of its row into its trial, and only then reads the trials again. Of two
that want one row, the one that writes later is sure to see the other's number and takes another
row; if both write before either reads, both do. Nobody waits.
"""

import optuna
from optuna.trial import FrozenTrial, TrialState

from study.sampler.history import ROW_ATTRIBUTE, row_of
from study.sampler.rows import Rows


def withdraw_or_keep(
    study: optuna.Study, trial: FrozenTrial, table: Rows, row: int, withdrawn: set[int]
) -> bool:
    """Whether the row just written into `trial` is its own; if not, add it to those withdrawn.

    A trial that was enqueued with the row, and still waits, has it too; one that has the number and
    did something else has not.
    """
    for other in study.get_trials(deepcopy=False):
        if other.number == trial.number:
            continue
        claims = other.user_attrs.get(ROW_ATTRIBUTE) == row or other.state is TrialState.WAITING
        if claims and row_of(table, other) == row:
            withdrawn.add(row)
            return False
    return True
