"""What was proposed for the trials that run in this process, and what was noted in them."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from optuna.trial import FrozenTrial

REMEMBERED = 1024  # trials; those that are never told would else pile up

Key = tuple[int, datetime | None]


@dataclass(frozen=True)
class Proposal:
    """Of one trial.

    Attributes:
        values: by parameter; none where the independent sampler gives them.
        notes: user attributes that say what these values are.
    """

    values: Mapping[str, Any]
    notes: Mapping[str, Any]

    def was_run(self, params: Mapping[str, Any]) -> bool:
        """Whether a trial of these parameters had all of the values."""
        return all(name in params and params[name] == v for name, v in self.values.items())

    def other_in(self, params: Mapping[str, Any]) -> str | None:
        """The first parameter that a trial of these had with another value; None without any."""
        others = (name for name, v in self.values.items() if name in params and params[name] != v)
        return next(others, None)


NOTHING = Proposal({}, {})


class Proposals:
    """By trial. Nothing is decided by them that the trials do not say: another process has none."""

    def __init__(self) -> None:
        self._kept: dict[Key, Proposal] = {}

    def keep(self, trial: FrozenTrial, proposal: Proposal) -> None:
        """Remember, in place of what was, and forget the oldest if they are many."""
        self._kept[_key(trial)] = proposal
        if len(self._kept) > REMEMBERED:
            self._kept.pop(next(iter(self._kept)), None)

    def of(self, trial: FrozenTrial) -> Proposal | None:
        """The trial's; None where this process has made none."""
        return self._kept.get(_key(trial))

    def take(self, trial: FrozenTrial) -> Proposal | None:
        """The same, and forget it."""
        return self._kept.pop(_key(trial), None)

    def __getstate__(self) -> dict[str, Any]:
        """Without those that run here."""
        return {"_kept": {}}


def _key(trial: FrozenTrial) -> Key:
    """What tells trials apart, also those of different studies."""
    return trial.number, trial.datetime_start
