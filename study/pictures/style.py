"""Common to all pictures: colours that survive colour blindness and print, fonts, saving.

Figures are made with Matplotlib's object-oriented interface; its global state is never
touched.
"""

from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from storage.commit import commit

# Of the eight of Okabe and Ito, which survive colour blindness: all but yellow, too
# pale for lines. Those that come after them are far from all others in the space CIELAB.
BLACK, BLUE, VERMILION = "#000000", "#0072B2", "#D55E00"
OTHERS = (
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    BLACK,
    "#8A9099",
    "#6B4A12",
    "#332288",
    "#8964F7",
    "#26594C",
    "#C8B560",
    "#EE6677",
    "#4C2659",
)

INK = "#22262B"
FAINT = "#8A9099"  # of what stands back, such as spines and peers
GRID = "#E3E6EA"
GROUND = "#CFC8BC"
MODEL = BLUE
OTHER_LEG = VERMILION
HUMAN = "#9AA0A8"
EMG = "#F3D9A4"
DEVICE = "#26594C"
TORQUE = "#009E73"  # of the device
FAR_LIMB = "#DDE1E6"
NEAR_LIMB = "#BEC5CE"
# Its lightness falls monotonically: readable in grey and without red-green.
ACTIVATION_MAP = "YlOrRd"

SMALL_PT = 8.0
TEXT_PT = 9.0
TITLE_PT = 11.0
SMALLEST_PT = 1.0  # which nobody reads
# How Matplotlib writes words of these sizes.
SMALL: dict[str, Any] = {"fontsize": SMALL_PT, "color": INK}
TEXT: dict[str, Any] = {"fontsize": TEXT_PT, "color": INK}
TITLE: dict[str, Any] = {"fontsize": TITLE_PT, "color": INK}
PNG_DPI = 200
PNG_START, PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"


def new_figure(width_in: float, height_in: float, dpi: float = PNG_DPI) -> Figure:
    """An empty white figure with an Agg canvas.

    Args:
        width_in: in inches.
        height_in: in inches.
        dpi: pixels an inch.
    """
    figure = Figure(figsize=(width_in, height_in), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def axes_at(
    figure: Figure, left_in: float, bottom_in: float, wide_in: float, high_in: float
) -> Axes:
    """Axes at a place and of a size in inches.

    Args:
        figure: that they are added to.
        left_in: from the figure's left edge, inches.
        bottom_in: from its lower edge, inches.
        wide_in: their width, inches.
        high_in: their height, inches.
    """
    wide, high = figure.get_figwidth(), figure.get_figheight()
    return figure.add_axes(
        (left_in / wide, bottom_in / high, wide_in / wide, high_in / high)
    )


def fit(text: Text, wide_in: float) -> None:
    """Write a line smaller, where it would be wider than so many inches."""
    figure = text.get_figure(root=True)
    assert figure is not None
    # More than once: the widths of letters are whole pixels.
    while (over := text.get_window_extent().width / (wide_in * figure.dpi)) > 1.0:
        size = float(text.get_fontsize())
        text.set_fontsize(size / (1.01 * over))
        if size < SMALLEST_PT:
            return


def tidy(axes: Axes) -> None:
    """Thin spines, faint grid, small readable ticks."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
    axes.tick_params(colors=INK, labelsize=SMALL_PT, color=FAINT, length=3)
    axes.grid(True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)


def save_png(figure: Figure, path: str | Path) -> Path:
    """Write the figure as a PNG, whole or not at all.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    path = Path(path)
    commit(path, partial(figure.savefig, format="png"), _check_png)
    return path


def _check_png(path: Path) -> None:
    content = path.read_bytes()
    if not (content.startswith(PNG_START) and content.endswith(PNG_END)):
        raise OSError("the picture was not written whole")
