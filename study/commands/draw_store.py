"""Draw a store: which gaits survive which family of disturbances, and at which speed.

Of another simulator than the walker the second number is what its store keeps for each world.

    taichi-nmm draw-store out/store-stairs --out out/store-stairs.png

Grey dots are points of the grid; red dots are candidates that a search has bred. Exit codes: 0, 2
bad input.
"""

from argparse import Namespace
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from storage.simulator import SURVIVED
from storage.store import (
    EVOLVED_ROW,
    ORIGIN,
    SOBOL_ROW,
    Store,
    evaluated_name,
    family_names,
    open_store,
)
from study.pictures import style
from taichi_nmm.errors import InputError

COLUMNS = 3  # of panels
PANEL_IN = (2.6, 2.2)
SPEED = "mean_speed_mps"  # on the base setting, level ground as a rule
LOOKS = {SOBOL_ROW: (style.FAINT, "grid", 3.0), EVOLVED_ROW: (style.VERMILION, "evolved", 5.0)}


def main(args: Namespace) -> None:
    """Draw it and print the path."""
    out = args.out or args.store.with_suffix(".png")
    print(style.save_png(draw_store(open_store(args.store)), out))


def draw_store(store: Store) -> Figure:
    """A panel a family, a dot a row that was run on it: survived share over speed.

    Raises:
        InputError: a store without families.
    """
    if not store.families:
        raise InputError("store", str(store.path), "a store with families of settings")
    lines = -(-len(store.families) // COLUMNS)
    figure = style.new_figure(COLUMNS * PANEL_IN[0], lines * PANEL_IN[1] + 0.3)
    panels = figure.subplots(lines, COLUMNS, sharex=True, sharey=True, squeeze=False)
    for number, family in enumerate(store.families):
        axes = panels.flat[number]
        style.tidy(axes)
        for origin, speed, survived in dots(store, family):
            colour, label, size = LOOKS[origin]
            axes.scatter(speed, survived, s=size, color=colour, linewidths=0, label=label)
        axes.set_title(family, fontsize=style.TEXT_PT, color=style.INK)
        if number % COLUMNS == 0:
            axes.set_ylabel("survived share", fontsize=style.SMALL_PT)
        if number + COLUMNS >= len(store.families):
            name = beside(store)
            label = "speed on the base setting (m/s)" if name == SPEED else f"{name}, base setting"
            axes.set_xlabel(label, fontsize=style.SMALL_PT)
            axes.tick_params(labelbottom=True)
    for axes in panels.flat[len(store.families) :]:
        axes.set_axis_off()
    panels.flat[0].set_ylim(-0.02, 1.02)
    panels.flat[0].legend(fontsize=style.SMALL_PT, frameon=False, loc="lower right")
    figure.tight_layout()
    return figure


def beside(store: Store) -> str:
    """The column of the second number, on the base setting; survival, if there is no other."""
    if SPEED in store.columns:
        return SPEED
    family = f"{store.families[0]}_"
    kept = [name.removesuffix("_worlds") for name in store.columns if name.endswith("_worlds")]
    others = [name.removeprefix(family) for name in kept if name.startswith(family)]
    return next((name for name in others if name != SURVIVED), SURVIVED)


def dots(
    store: Store, family: str
) -> Iterator[tuple[str, NDArray[np.float64], NDArray[np.float64]]]:
    """By origin: speeds (see `beside`) and survived shares of the rows of a family, [n] each."""
    names = [evaluated_name(family), beside(store), family_names(family, SURVIVED)[0]]
    table = store.table(names)
    run, speed, survived = (table[name].to_numpy() for name in names)
    origins = np.full(len(run), SOBOL_ROW)
    if ORIGIN in store.columns:
        origins = store.numpy([ORIGIN])[ORIGIN]
    for origin in LOOKS:
        chosen = run & (origins == origin)
        if chosen.any():
            yield origin, speed[chosen], survived[chosen]
