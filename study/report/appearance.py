"""How arms look: colour says the kind, marker and dash the arm; three arms stand in front.

In a grey print the lines in front are known by width and dash, all others by the label at their
end.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from study.experiment.arms import ARMS, BEST_ARM, PAPER_ARM, Kind
from study.palette import BACK, BACK_DASH, BACK_TEXT, FRONT, FRONT_DASH
from study.report.runs import ArmRuns

MARKERS = "osD^vPX<>ph*dH8"


@dataclass(frozen=True)
class Look:
    """How one arm is drawn.

    Attributes:
        label: what a reader calls it.
        colour: of its line.
        text: of its label.
        dash: of its line, as Matplotlib has it.
        marker: of its points, as Matplotlib has it.
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


def label_of(arm: str) -> str:
    """What a reader calls an arm; one of an old folder that nobody knows any more, its name."""
    return ARMS[arm].label if arm in ARMS else arm


def kind_of(arm: str) -> Kind:
    """Whose an arm is; one that nobody knows any more was ours."""
    return ARMS[arm].kind if arm in ARMS else "ours"


def best_peer(arms: Iterable[ArmRuns]) -> str | None:
    """The peer with most runs that have a walker; of equals the earliest, then the cheapest."""
    peers = [arm for arm in arms if kind_of(arm.arm) == "peer"]
    return min(peers, key=_rank).arm if peers else None


def looks(arms: Mapping[str, ArmRuns]) -> dict[str, Look]:
    """The look of each arm, in the order given."""
    front = {PAPER_ARM: "paper", BEST_ARM: "best", best_peer(arms.values()): "peer"}
    found: dict[str, Look] = {}
    members = dict.fromkeys(BACK, 0)  # a marker for each of a kind
    for arm in arms:
        role, kind = front.get(arm), kind_of(arm)
        label, marker = label_of(arm), MARKERS[members[kind] % len(MARKERS)]
        members[kind] += 1
        if role is not None:
            found[arm] = Look(label, FRONT[role], FRONT[role], FRONT_DASH[role], marker, True)
        else:
            found[arm] = Look(label, BACK[kind], BACK_TEXT[kind], BACK_DASH[kind], marker, False)
    return found


def by_rank(arms: Mapping[str, ArmRuns]) -> list[str]:
    """The arms, best first: runs with a walker, then when, then at what cost."""
    return sorted(arms, key=lambda arm: _rank(arms[arm]))


def _rank(arm: ArmRuns) -> tuple[float, float, float]:
    share = arm.walkers / len(arm.runs)
    return -share, float(np.median(arm.first_walker)), float(np.median(arm.best[:, -1]))
