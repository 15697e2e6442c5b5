"""The eight pictures of docs/explorer.md, of a store and comparisons in out/, which these make:

    taichi-nmm precompute --config quickstart-store
    taichi-nmm compare --config risers --arms worlds --runs 1 --store out/quickstart-store
    taichi-nmm compare --config exo --arms bo-euclidean --runs 1
    python -m tests.study.explore.screenshots

Walks stand still at one moment; a picture has 256 colours, and so few bytes.
"""

from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from tests.browser import opened_page
from tests.study.explore.serving import change, opened, show_row, walks

OUT, IMG = Path("out"), Path("docs/img")  # of the checkout
ROW = 1485  # of the store
SHOWN_S = 4.4  # of each walk
LAID_OUT_MS = 3000  # until a page has been laid out anew


def keep(page, name, part=None, columns=1):
    """A picture of the window or of a part; or of the whole page, cut into columns."""
    change(page, "play", "active", False)
    page.wait_for_timeout(LAID_OUT_MS)
    page.wait_for_function("stopped_at", arg=SHOWN_S)
    page.wait_for_timeout(500)
    taken = part.screenshot() if part else page.screenshot(full_page=columns > 1)
    pixels = np.asarray(Image.open(BytesIO(taken)).convert("RGB"))
    pixels = np.hstack(np.split(pixels[: len(pixels) // columns * columns], columns))
    few = Image.fromarray(pixels).quantize(256, dither=Image.Dither.NONE)
    few.save(IMG / f"explorer-{name}.png", optimize=True)


def turn_to(page, part):
    page.get_by_role("button", name=part, exact=True).click()


def draw_store(page):
    """A store by day, by night and on a phone; two of its gaits, their signals, and a what if."""
    with opened(page, OUT / "quickstart-store"):
        show_row(page, ROW)
        keep(page, "store")
        page.emulate_media(color_scheme="dark")
        keep(page, "dark")
        page.emulate_media(color_scheme="light")
        page.set_viewport_size({"width": 390, "height": 844})
        keep(page, "phone", columns=3)
        page.set_viewport_size({"width": 1500, "height": 1000})
        walks(page, lambda: page.get_by_text("keep it beside").click())
        walks(page, lambda: change(page, "start", "value", "published"))
        turn_to(page, "score")
        keep(page, "gaits", page.locator(".column").last)
        turn_to(page, "signals")
        page.wait_for_function("named('signals-1-beside')?.data.x.length > 1000")
        keep(page, "signals", page.locator("details").last)
        turn_to(page, "what if")
        page.wait_for_function("named('lines') !== null")
        walks(page, page.get_by_text("remove").click)
        slider = "world.muscles.SOL_left"
        walks(page, lambda: change(page, slider, "value", 0.5))
        keep(page, "what-if", page.locator(".column").last)


def draw_studies(page):
    """A study, and strides of two of the gaits of another one."""
    page.set_viewport_size({"width": 1280, "height": 1000})
    with opened(page, OUT / "compare" / "risers", "--study", "risers/worlds/run-000"):
        keep(page, "study")
    page.set_viewport_size({"width": 1500, "height": 1000})
    with opened(page, OUT / "compare" / "exo", "--study", "exo/bo-euclidean/run-000"):
        walks(page, lambda: page.get_by_text("keep it beside").click())
        walks(page, lambda: change(page, "start", "value", "reference"))
        change(page, "ghost", "active", True)
        turn_to(page, "stride beside people")
        page.wait_for_function("named('cycle-knee')?.inner_width > 100")
        keep(page, "strides", page.locator(".column").last)


if __name__ == "__main__":
    with opened_page(1280, 1000) as page:
        draw_store(page)
        draw_studies(page)
