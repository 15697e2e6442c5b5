"""The components of the score, before and after the gains were changed."""

import html

import numpy as np
from bokeh.models import Div

from taichi_nmm.result import OUTCOME_FIELDS, SCORE_FIELDS

LEFT_OUT = ("end_reason", "hip_x_m", "hip_z_m")
FIELDS = tuple(name for name, _ in (*OUTCOME_FIELDS, *SCORE_FIELDS) if name not in LEFT_OUT)
HEAD = "<tr><th align=left></th><th>start</th><th>now</th><th>change</th></tr>"


class Score:
    """A table of numbers of two walks on the same ground."""

    def __init__(self) -> None:
        """Empty."""
        self._start: np.void | None = None
        self.layout = Div(text="", name="score", width=420)

    def show(self, row: np.void, start: bool) -> None:
        """The result row of a walk; `start`: the next ones are compared with it."""
        if start or self._start is None:
            self._start = row
        lines = [_line(name, float(self._start[name]), float(row[name])) for name in FIELDS]
        self.layout.text = f"<table cellspacing=4>{HEAD}{''.join(lines)}</table>"


def _line(name: str, start: float, now: float) -> str:
    cells = "".join(f"<td align=right>{text}</td>" for text in (f"{start:.4g}", f"{now:.4g}"))
    change = "" if start == now else f"{now - start:+.3g}"
    return f"<tr><td>{html.escape(name)}</td>{cells}<td align=right><b>{change}</b></td></tr>"
