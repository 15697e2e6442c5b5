"""The mean strides of a walk, of both legs and of all muscles, beside the ranges of people."""

import numpy as np
from bokeh.models import Column, Div, Span

from study.explore.curves import Plot, curve, people
from study.explore.server import flow
from study.explore.walk import Walk
from study.pictures import gait_cycle, style
from study.pictures.gait_cycle import PANELS, PERCENT, Strides
from study.pictures.stick_figure import LEFT, RIGHT, finite

HEIGHT_PX, LEAST_PX = 180, 215  # of a panel of the stride


class Cycle:
    """A small figure for each joint, each ground force and each muscle."""

    def __init__(self) -> None:
        self._words = Div(name="cycle")
        # Where the left foot leaves the ground, in each panel.
        self._toe_off = Span(
            dimension="height", line_color=style.MODEL, line_dash="dotted"
        )
        self.plots = {
            name: Plot(
                f"cycle-{panel.title}",
                height=HEIGHT_PX,
                tools="",
                toolbar_location=None,
                x_axis_label="stride (%)",
                x_range=(0, 100),
                y_axis_label=panel.unit,
                y_range=(panel.low, panel.high),
            )
            for name, panel in PANELS.items()
        }
        figures = [plot.figure for plot in self.plots.values()]
        for each in figures:
            each.title.align = "right"  # where it has most room
            each.add_layout(self._toe_off)
        self.layout = Column(self._words, flow(*figures, least_px=LEAST_PX))

    def show(self, walk: Walk, other: Walk | None) -> None:
        """The mean strides of a walk, if it has enough; of another walk, those of the left leg."""
        left, right = _strides(walk, LEFT), _strides(walk, RIGHT)
        lines = {"signal": left, "right": right}
        if other is not None:
            lines["beside"] = _strides(other, LEFT)
        self._words.text = (
            f"{gait_cycle.subtitle(left)} Blue: left leg, 1 sd and toe-off (dotted); orange: right "
            f"leg; black, dashed: the gait beside it. Grey: {gait_cycle.SOURCE}, number: RMSE; "
            f"sand: {gait_cycle.EMG_SOURCE}."
        )
        self._toe_off.location = left.toe_off_percent
        distances = gait_cycle.human_distances(left)
        for name, panel in PANELS.items():
            plot = self.plots[name]
            curves = people(panel)
            for look, strides in lines.items():
                curves[look] = curve(PERCENT, strides.mean(name))
            low, high = left.band(name)
            curves["signal"].update(low=low, high=high)
            plot.draw(curves)
            title = panel.title.removeprefix("ground ")
            if far := distances.get(name):
                unit = name.rpartition("_")[2]
                title += f": {far.rmse:.2g} {unit}, {far.deviations:.2g} sd"
            plot.figure.title.text = title
            drawn = (curves[look]["y"] for look in lines)
            seen = np.concatenate([[panel.low, panel.high], low, high, *drawn])
            ends = plot.figure.y_range
            ends.start, ends.end = np.nanmin(seen), np.nanmax(seen)


def _strides(walk: Walk, side: int) -> Strides:
    return gait_cycle.strides_of(
        finite(walk.trajectory), walk.experiment.weight_n(walk.run), side
    )
