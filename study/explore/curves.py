"""Curves of gaits beside people's, as the figures of signals and of strides have them."""

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure

from study.pictures import style
from study.pictures.gait_cycle import PERCENT, Panel

# Colour, strength of the band and dash, from the back to the front: what people do, when
# their muscle is on, the other leg, the gait, and the one beside it.
LOOKS = {
    "people": (style.HUMAN, 0.35, "dotted"),
    "on": (style.EMG, 0.6, "solid"),
    "right": (style.OTHER_LEG, 0.0, "solid"),
    "signal": (style.MODEL, 0.25, "solid"),
    "beside": (style.BLACK, 0.2, "dashed"),
}
Curve = dict[str, Any]
"""A line `y` over `x` with a band from `low` to `high`."""

Curves = dict[str, Curve]
"""By the names of `LOOKS`."""


def curve(x: Any, y: Any, sd: Any = 0.0) -> Curve:
    """A line with a band of `sd` about it, each [p]."""
    return {"x": x, "y": y, "low": y - sd, "high": y + sd}


NOTHING = curve(np.zeros(0), np.zeros(0))


class Plot:
    """A figure with a source for each of `LOOKS`; `words` are those of Bokeh's `figure`."""

    def __init__(self, name: str, **words: Any) -> None:
        self.figure = plot = figure(name=name, title="", **words)
        plot.title.text_font_size = "11px"
        self.sources = {}
        for look, (colour, alpha, dash) in LOOKS.items():
            source = ColumnDataSource(NOTHING, name=f"{name}-{look}")
            self.sources[look] = source
            plot.varea(
                "x", "low", "high", source=source, fill_color=colour, fill_alpha=alpha
            )
            plot.line(
                "x",
                "y",
                source=source,
                line_color=colour,
                line_dash=dash,
                line_width=1.5,
            )

    def draw(self, curves: Curves) -> None:
        """Draw these, by the names of `LOOKS`, alone."""
        for look, source in self.sources.items():
            source.data = curves.get(look, NOTHING)


def people(panel: Panel, unit: float = 1.0) -> Curves:
    """What people do over a stride, or when their muscle is on; `unit` is that of the panel."""
    if panel.on_percent:
        high = np.tile([0.0, 1.0, 1.0, 0.0], len(panel.on_percent)) * panel.ceiling
        return {"on": curve(np.repeat(panel.on_percent, 2), high) | {"low": 0.0 * high}}
    mean, sd = panel.at(PERCENT)
    return {"people": curve(PERCENT, unit * mean, abs(unit) * sd)}
