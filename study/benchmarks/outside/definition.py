"""What a tuning problem is: settings, what is known of each cheaply, and what it costs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from optuna.distributions import BaseDistribution

Settings = Mapping[str, float | int | str]  # one candidate: its parameters by name
Purpose = Literal["tuning", "reported"]


@dataclass(frozen=True)
class Feature:
    """A cheap number that a practitioner would have of each candidate, as it comes.

    Attributes:
        good: the end that practitioners prefer.
        meaning: with its unit.
    """

    good: Literal["low", "high"]
    meaning: str


@dataclass(frozen=True)
class Definition:
    """A problem and how its numbers are computed; equal settings give equal numbers.

    Attributes:
        name: of the problem and its file.
        purpose: "tuning", a sampler may be improved on it; "reported", it is looked at once.
        field: whose problem it is.
        cost_meaning: what is minimised, with its unit.
        space: of the settings.
        features: by name, k of them.
        cheap: features of one candidate, k numbers; what failed is infinite or NaN.
        costly: cost of one candidate, finite.
    """

    name: str
    purpose: Purpose
    field: str
    cost_meaning: str
    space: Mapping[str, BaseDistribution]
    features: Mapping[str, Feature]
    cheap: Callable[[Settings], tuple[float, ...]]
    costly: Callable[[Settings], float]
