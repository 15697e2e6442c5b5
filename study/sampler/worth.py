"""Whether the features of a study are worth anything: the figures, a verdict, and a small table."""

from collections.abc import Iterator
from dataclasses import dataclass

import scipy

from study.sampler.rank_correlation import RankCorrelation
from study.sampler.weights import Weights, percents

LEAST_TRIALS = 5
# Standard errors that make a gain: with two, one in ten studies of features that say nothing would
# have one, since the constants were learned from the trials that are left out.
GAIN = 3.0
TITLE = "Are the features worth anything?"
HEAD = ("feature", "rank correlation with the cost", "weight")
UNKNOWN = "-"
CHOSEN = (
    "In brackets: 95 %. Trials are chosen, not drawn: among the best rows, correlations are weaker "
    "than over all, and what features were worth in choosing these rows does not show. Some rows "
    "drawn at random would tell."
)
WEIGHT = (
    "Weight: the share of the costs' variation over all candidates that the model puts down to it."
)
MAXIMISED = "The cost is minus the study's value."
DOUBTED = (
    "No trial has been better than all before for some time: every other one is left to the "
    "parameters."
)


@dataclass(frozen=True)
class Errors:
    """Leave-one-out errors, as shares of that of a constant.

    Attributes:
        model: of the sampler's model.
        without: of one over the parameters alone; None: the sampler has none.
        gain: by how much the model is nearer to the costs than the better of the others, on
            average over the trials, in standard errors of this average.
    """

    model: float
    without: float | None
    gain: float


@dataclass(frozen=True)
class Worth:
    """What features were worth to a sampler in the finished trials of a study.

    Attributes:
        trials: that could be learned from.
        names: of the k features; () where nothing is known of them yet.
        correlations: of each with the cost; None: too few trials have it, or it is constant.
        weights: that the model gives; None: too few trials.
        errors: None: too few trials, or all cost the same.
        is_doubted: every other trial is left to the parameters at present.
        maximised: the study's value is; costs are minus the values.
    """

    trials: int
    names: tuple[str, ...]
    correlations: tuple[RankCorrelation | None, ...]
    weights: Weights | None
    errors: Errors | None
    is_doubted: bool
    maximised: bool

    @property
    def verdict(self) -> str:
        """In a sentence; a correlation counts that is sure at 95 % for all features at once."""
        if self.trials < LEAST_TRIALS:
            return f"too few trials: {self.trials} of {LEAST_TRIALS}"
        if self.errors is None:
            return f"nothing is known of the features: all {self.trials} trials cost the same"
        without = self.errors.without
        other = "" if without is None else f", and {without:.2f} of it without features"
        error = f"the model's error is {self.errors.model:.2f} of a constant's{other}"
        better = self.errors.model < min(1.0, 1.0 if without is None else without)
        if better and self.errors.gain > GAIN:
            return f"The features explain part of the costs of these trials: {error}."
        if (found := self._strongest()) is not None:
            name, r = found
            gain = "may gain" if better else "does not gain"
            return (
                f"The costs follow a feature ({name}, {r.value:+.2f}); among these trials, the "
                f"model {gain} by the features: {error}."
            )
        if better:
            return (
                f"The features may explain part of the costs, which {self.trials} trials do not "
                f"settle: {error}."
            )
        return f"Among these trials, the features are not (yet) worth anything: {error}."

    def _strongest(self) -> tuple[str, RankCorrelation] | None:
        """The feature that goes with the cost most surely; None: none is sure, of so many."""
        named = zip(self.names, self.correlations, strict=True)
        known = [(name, r) for name, r in named if r is not None]
        if not known:
            return None
        best = max(known, key=lambda one: abs(one[1].errors))
        needed = float(scipy.special.ndtri(1.0 - 0.025 / len(known)))  # Bonferroni
        return best if abs(best[1].errors) > needed else None

    def __str__(self) -> str:
        """A table for people."""
        rows = [HEAD, *self._rows()]
        widths = [max(len(row[column]) for row in rows) for column in range(len(HEAD))]
        lines = [
            f"{name:<{widths[0]}}  {r:<{widths[1]}}  {weight:>{widths[2]}}"
            for name, r, weight in rows
        ]
        return "\n".join([self.verdict, "", *(lines if self.names else ()), *self._remarks()])

    def markdown(self) -> str:
        """The same for a note in the dashboard."""
        head = ["| " + " | ".join(HEAD) + " |", "|---|---|--:|"]
        rows = ["| " + " | ".join(map(_escaped, row)) + " |" for row in self._rows()]
        table = [*head, *rows, ""] if self.names else []
        return "\n".join([f"## {TITLE}", "", self.verdict, "", *table, *self._remarks()]).rstrip()

    def _rows(self) -> Iterator[tuple[str, str, str]]:
        """Of the table: features, and what they leave to others."""
        weights = [UNKNOWN] * len(self.names)
        others: list[tuple[str, str, str]] = []
        if self.weights is not None:
            shares = (*self.weights.features, self.weights.parameters, self.weights.noise)
            *weights, parameters, noise = (f"{share} %" for share in percents(shares))
            if self.weights.parameters > 0:
                others.append(("(parameters)", "", parameters))
            others.append(("(noise)", "", noise))
        for name, r, weight in zip(self.names, self.correlations, weights, strict=True):
            yield name, _correlation_text(r), weight
        yield from others

    def _remarks(self) -> Iterator[str]:
        """What is to be known of the figures."""
        if not self.names:
            return
        yield f"{self.trials} trials. {CHOSEN}"
        if self.weights is not None:
            yield WEIGHT
        if self.maximised:
            yield MAXIMISED
        if self.is_doubted:
            yield DOUBTED


def _correlation_text(r: RankCorrelation | None) -> str:
    return UNKNOWN if r is None else f"{r.value:+.2f} ({r.low:+.2f} to {r.high:+.2f})"


def _escaped(cell: str) -> str:
    """So that a name does not end a cell."""
    return cell.replace("|", "\\|")
