"""The six pictures of docs/explorer.md, of stores and comparisons in out/, which these make:

    taichi-nmm precompute --config store-worlds    # and store-exo
    taichi-nmm compare --config risers --arms worlds --runs 1    # and exo
    python -m tests.study.explore.screenshots

Walks stand still at one moment; a picture has 256 colours, and so few bytes.
"""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.browser import opened_page
from tests.study.explore.serving import change, opened, show_row, walks

OUT, IMG = Path("out"), Path("docs/img")  # of the checkout
BRED_ROW = 20100  # of the store
SHOWN_S = 4.4  # of each walk


def keep(page: Any, name: str, part: Any = None, columns: int = 1) -> None:
    """A picture of the window or of a part; or of the whole page, cut into columns."""
    change(page, "play", "active", False)
    change(page, "time", "value", SHOWN_S)
    page.wait_for_timeout(1500)  # it has been laid out anew
    taken = part.screenshot() if part else page.screenshot(full_page=columns > 1)
    pixels = np.asarray(Image.open(BytesIO(taken)).convert("RGB"))
    pixels = np.hstack(np.split(pixels[: len(pixels) // columns * columns], columns))
    few = Image.fromarray(pixels).quantize(256, dither=Image.Dither.NONE)
    few.save(IMG / f"explorer-{name}.png", optimize=True)


def draw(page: Any) -> None:
    """A study; a store by day, by night, on a phone, and two of its gaits; strides of two gaits."""
    with opened(page, OUT / "compare" / "risers", "--study", "risers/worlds/run-000"):
        keep(page, "study")
    with opened(page, OUT / "store-worlds"):
        show_row(page, BRED_ROW)
        keep(page, "store")
        page.emulate_media(color_scheme="dark")
        keep(page, "dark")
        page.emulate_media(color_scheme="light")
        page.set_viewport_size({"width": 390, "height": 844})
        keep(page, "phone", columns=3)
        page.set_viewport_size({"width": 1500, "height": 1000})
        walks(page, lambda: page.get_by_text("keep it beside").click())
        walks(page, lambda: change(page, "start", "value", "published"))
        page.get_by_text("score", exact=True).click()
        keep(page, "gaits", page.locator(".column").last)
    with opened(page, OUT / "compare" / "exo", "--study", "exo/worlds/run-000"):
        walks(page, lambda: page.get_by_text("keep it beside").click())
        walks(page, lambda: change(page, "start", "value", "reference"))
        change(page, "ghost", "active", True)
        page.get_by_text("stride beside people").click()
        page.wait_for_function("named('cycle-knee')?.inner_width > 100")
        keep(page, "strides", page.locator(".column").last)


if __name__ == "__main__":
    with opened_page(1280, 1000) as page:
        draw(page)
