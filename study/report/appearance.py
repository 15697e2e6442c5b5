"""How arms look: colour says the family, marker and dash the arm; three arms stand in front.

Colours are Okabe and Ito's, which survive colour blindness. In a grey print the lines in front are
known by width and dash, all others by the label at their end.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from study.report.results import ArmRuns

PAPER = "dog"  # the paper's method, to which all others are compared
BEST = "best"  # our best combination
PEERS = ("random", "cmaes-cold", "cmaes-warm", "cmaes-source", "bo-euclidean", "gp-optuna", "tpe")
CONTROLS = ("score-first", "score-top", "ei-prior")

LABELS = {
    "random": "random",
    "cmaes-cold": "CMA-ES",
    "cmaes-warm": "CMA-ES, warm",
    "cmaes-source": "CMA-ES, source",
    "bo-euclidean": "plain BO",
    "gp-optuna": "GPSampler",
    "tpe": "TPE",
    "dog": "DoG, as printed",
    "dog-kd": "DoG, k-D",
    "dog-robust": "DoG, robust score",
    "dog-off-grid": "DoG, off the grid",
    "score-first": "best score first",
    "score-top": "random in top 100",
    "ei-prior": "plain BO, score prior",
    "dog-mild": "DoG, mild score",
    "dog-ramps": "DoG, ramps' score",
    "dog-diverse": "DoG, diverse score",
    "score-first-flat": "best printed score first",
    "score-first-diverse": "best diverse score first",
    "best": "best combination",
    "best-robust": "best, rough store",
    "best-mild": "best, mild store",
    "best-ramps": "best, ramps' store",
    "best-without-rough": "best, no rough seen",
    "best-without-ramps": "best, no ramps seen",
}

FRONT = {"paper": "#0072B2", "best": "#D55E00", "peer": "#000000"}
FRONT_DASH: dict[str, Any] = {"paper": (0, (6, 1.6)), "best": "solid", "peer": (0, (2.2, 1.4))}
BACK = {"ours": "#6F9FC6", "peer": "#8A9099", "control": "#C69250"}
TEXT = {"ours": "#35658C", "peer": "#5A616A", "control": "#85591C"}  # the same, dark enough to read
BACK_DASH = {"ours": "solid", "peer": (0, (4, 2)), "control": (0, (1, 1.5))}
MARKERS = "osD^vPX<>ph*d"


@dataclass(frozen=True)
class Look:
    """How one arm is drawn.

    Attributes:
        label: what a reader calls it.
        colour: of its line.
        text: of its label.
        dash: of its line, as Matplotlib has it.
        marker: of its points.
        front: whether it is one of the three in front, with a band.
    """

    label: str
    colour: str
    text: str
    dash: Any
    marker: str
    front: bool

    def line(self) -> dict[str, Any]:
        """Keyword arguments of `Axes.plot`."""
        return {
            "color": self.colour,
            "linestyle": self.dash,
            "linewidth": 2.0 if self.front else 1.0,
            "marker": self.marker,
            "markersize": 5.0 if self.front else 3.2,
            "markeredgewidth": 0.0,
            "zorder": 4.0 if self.front else 3.0,
        }


def family(arm: str) -> str:
    """ "peer", "control" or "ours"; stores of other settings keep the family of the arm."""
    if arm in PEERS:
        return "peer"
    return "control" if arm.startswith(CONTROLS) else "ours"


def best_peer(arms: Iterable[ArmRuns]) -> str | None:
    """The peer with most runs that have a walker; of equals the earliest, then the cheapest."""
    peers = [arm for arm in arms if arm.arm in PEERS]
    if not peers:
        return None
    return min(peers, key=_rank).arm


def looks(arms: dict[str, ArmRuns]) -> dict[str, Look]:
    """The look of each arm, in the order given."""
    front = {PAPER: "paper", BEST: "best", best_peer(arms.values()): "peer"}
    found: dict[str, Look] = {}
    members = dict.fromkeys(BACK, 0)  # a marker for each of a family
    for arm in arms:
        role, kind = front.get(arm), family(arm)
        label, marker = LABELS.get(arm, arm), MARKERS[members[kind] % len(MARKERS)]
        members[kind] += 1
        if role is not None:
            found[arm] = Look(label, FRONT[role], FRONT[role], FRONT_DASH[role], marker, True)
        else:
            found[arm] = Look(label, BACK[kind], TEXT[kind], BACK_DASH[kind], marker, False)
    return found


def by_rank(arms: dict[str, ArmRuns]) -> list[str]:
    """The arms, best first: runs with a walker, then when, then at what cost."""
    return sorted(arms, key=lambda arm: _rank(arms[arm]))


def _rank(arm: ArmRuns) -> tuple[float, float, float]:
    share = float(arm.has_walker[:, -1].mean())
    return -share, float(np.median(arm.first_walker)), float(np.median(arm.best[:, -1]))
