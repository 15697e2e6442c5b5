"""The explorer as a person uses it: a headless Chromium on a store."""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from storage.store import columns_of, open_store
from storage.tables import document_hash, write_table
from study.experiment.gains import gains_of_source
from study.explore.store_view import read_selection
from study.explore.walk import RATE_HZ, Walk, chosen_setting, walk
from study.pictures import stick_figure
from taichi_nmm.result import MUSCLES
from tests.browser import opened_page
from tests.cases import ASSETS, asset, cases
from tests.storage.fake import content
from tests.study import fake_walker
from tests.study.explore.serving import MODEL, change, opened, walks

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store whose gains are real, and whose scores are a formula's."""
    pytest.importorskip("bokeh", reason="no bokeh: pip install 'taichi-nmm[explore]'")
    folder = tmp_path_factory.mktemp("explored")
    fake_walker.write_store(folder / "store")
    return folder


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    """Of this file alone: it is larger than others."""
    with opened_page(1500, 1250) as page:
        said: list[str] = []
        page.on(
            "console",
            lambda line: said.append(line.text) if line.type == "error" else None,
        )
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        yield page
        assert said == []
        assert [
            url for url in asked if "://127.0.0.1:" not in url and url[:5] != "blob:"
        ] == []


@pytest.fixture(scope="module")
def store(folders: Path, page: Any) -> Iterator[Path]:
    """Opened in the page."""
    before = content(folders / "store")
    with opened(page, folders / "store"):
        yield folders / "store"
    assert content(folders / "store") == before  # nothing was written


SCRIPT = "<img src=x onerror=window.ran=1>"
TEX = r"$$\href{javascript:window.ran=1}{onerror}$$"


def test_names_of_a_file_are_text(page: Any, folders: Path, tmp_path: Path) -> None:
    """A store comes from anybody: what its columns are called is shown and never run."""
    store = open_store(folders / "store")
    table, names = (
        store.table(),
        [f"{name}_survived_fraction_mean" for name in (SCRIPT, TEX)],
    )
    for name in names:
        table = table.append_column(name, table["mean_speed_mps"])
    specification = store.specification | {"columns": columns_of(table.schema)}
    footer = store.footers[0] | {"rows": len(table), "specification": specification}
    footer["specification_hash"] = document_hash(specification)
    hostile = tmp_path / f"{SCRIPT}.parquet"
    write_table(hostile, table, footer)
    with opened(page, hostile):
        for slot, name in enumerate((*names, *names, names[0])):
            page.evaluate(
                f"(name) => {{ {MODEL}('column-{slot}').value = name }}", name
            )
        page.wait_for_function(f"{MODEL}('column-4').value.includes('onerror')")
        for name in (SCRIPT, TEX):
            page.evaluate(
                f"(text) => {{ {MODEL}('selection').value = text }}", f"{name} 0..1"
            )
            page.get_by_text(f"selection: {repr(name)[:9]}").wait_for()  # the message
        axes = "Bokeh.index.query((view) => view.model.type === 'LinearAxis')"
        drawn = page.evaluate(
            f"[...{axes}].map((one) => one._axis_label_view?.model.type)"
        )
        assert "PlainText" in drawn and "TeX" not in drawn
        headings = page.locator(".slick-column-name").all_inner_texts()
        assert sum("onerror" in heading for heading in headings) == 5
        assert page.evaluate("window.ran") is None


def model(page: Any, name: str, attribute: str) -> Any:
    """What a model of the page holds."""
    return page.evaluate(f"{MODEL}('{name}').{attribute}")


def frame(page: Any, name: str) -> tuple[float, float, float, float]:
    """Where the axes of a figure are on the screen: left, top, width and height, pixels."""
    left, top, width, height = page.evaluate(f"""(() => {{
        const [view] = Bokeh.index.query((view) => view.model.name === '{name}')
        const canvas = view.canvas_view.el.getBoundingClientRect(), inner = view.frame.bbox
        return [canvas.x + inner.left, canvas.y + inner.top, inner.width, inner.height]
    }})()""")
    return left, top, width, height


def drag(
    page: Any, name: str, start: tuple[float, float], end: tuple[float, float]
) -> None:
    """Draw a box in a figure: corners as shares of what lies within its axes."""
    left, top, width, height = frame(page, name)
    page.mouse.move(left + start[0] * width, top + start[1] * height)
    page.mouse.down()
    page.mouse.move(left + end[0] * width, top + end[1] * height, steps=3)
    page.mouse.up()


def at(page: Any, name: str, x: float, y: float) -> tuple[float, float]:
    """Where on the screen a figure has these coordinates."""
    left, top, width, height = frame(page, name)
    ends = [
        model(page, name, f"{axis}_range.{end}")
        for axis in "xy"
        for end in ("start", "end")
    ]
    across, up = (
        (x - ends[0]) / (ends[1] - ends[0]),
        (y - ends[2]) / (ends[3] - ends[2]),
    )
    return left + across * width, top + (1.0 - up) * height


def point(page: Any, row: int) -> tuple[float, float]:
    """Where on the screen a row is in the cloud."""
    rows = f"{MODEL}('rows').data"
    place = page.evaluate(f"{rows}.row.indexOf({row})")
    return at(
        page, "cloud", *page.evaluate(f"[{rows}.c0[{place}], {rows}.c1[{place}]]")
    )


def test_a_store_opens_with_all_its_rows(page: Any, store: Path) -> None:
    rows = len(open_store(store))
    assert page.evaluate("window.store_view.chosen") == rows == fake_walker.STORE_ROWS
    assert model(page, "count", "text") == f"{rows} of {rows} rows"
    image = f"{MODEL}('cloud').renderers[0].data_source.data.image[0]"
    assert page.evaluate(f"{image}.some((pixel) => pixel !== 0)")


def test_a_brush_filters_the_table_and_the_histograms(page: Any, store: Path) -> None:
    drag(page, "cloud", (0.3, 0.05), (0.9, 0.95))
    page.wait_for_function(f"{MODEL}('selection').value !== ''")
    page.wait_for_function("window.store_view.chosen < window.store_view.inside.length")
    chosen = page.evaluate("window.store_view.chosen")
    text = model(page, "selection", "value")
    low, high = read_selection(text, ("mean_speed_mps", "phi_printed"))[
        "mean_speed_mps"
    ]
    speeds = page.evaluate(f"[...{MODEL}('listed').data.c0]")
    assert 0 < len(speeds) == min(chosen, 200)
    assert all(low <= value <= high for value in speeds)
    bars = f"{MODEL}('histogram-1').renderers[1].data_source.data.count"
    assert page.evaluate(f"{bars}.reduce((sum, bar) => sum + bar)") == chosen
    drag(page, "histogram-1", (0.0, 0.5), (0.5, 0.5))
    page.wait_for_function(f"{MODEL}('selection').value !== {json.dumps(text)}")
    page.wait_for_function(f"window.store_view.chosen < {chosen}")
    change(page, "selection", "value", "mean_speed_mps 0..0.5")
    table = open_store(store).table(["mean_speed_mps"])["mean_speed_mps"].to_numpy()
    page.get_by_text(f"{(table <= 0.5).sum()} of {len(table)} rows").wait_for()
    assert page.evaluate("window.store_view.chosen") == int((table <= 0.5).sum())
    listed = page.locator(".slick-row").first.inner_text()
    assert float(listed.split()[1]) == pytest.approx(table[table <= 0.5][0], abs=1e-4)
    change(page, "selection", "value", "speed of light")
    page.wait_for_function(
        f"{MODEL}('selection-message').text.includes('column low..high')"
    )
    assert page.evaluate("window.store_view.all")  # and nothing is selected by it
    change(page, "selection", "value", "")
    page.wait_for_function(f"{MODEL}('selection-message').text === ''")


def test_a_click_walks_and_is_marked(page: Any, store: Path) -> None:
    walks(page, lambda: change(page, "row", "value", 17))
    page.get_by_text("store-row-17").first.wait_for()
    stage = {"x": 720, "y": 180, "width": 740, "height": 400}
    first, time = page.screenshot(clip=stage), page.evaluate("window.walk_player.time")
    page.wait_for_function(f"window.walk_player.time !== {time}")
    # The walk repeats: one later picture may be as the first, all of them cannot.
    later = (
        page.wait_for_timeout(170) or page.screenshot(clip=stage) for _ in range(8)
    )
    assert any(picture != first for picture in later)
    walks(page, lambda: page.mouse.click(*point(page, 40)))
    rows, row = f"{MODEL}('rows').data", model(page, "row", "value")
    shown = [
        page.evaluate(f"{rows}.c{slot}[{rows}.row.indexOf({row})]") for slot in range(5)
    ]
    assert [model(page, "rings", f"data.{axis}[0]") for axis in "xy"] == shown[:2]
    assert (
        row != 17
        and [model(page, f"at-{slot}", "location") for slot in range(5)] == shown
    )
    assert (
        model(page, "listed", f"data.row[{MODEL}('listed').selected.indices[0]]") == row
    )
    walks(page, lambda: page.mouse.click(*point(page, row)))  # again
    walks(page, page.locator(".slick-cell.selected").first.click)


def test_another_column_is_drawn_and_ranges_last(page: Any, store: Path) -> None:
    change(page, "selection", "value", "mean_speed_mps 0..0.5")
    page.wait_for_function("!window.store_view.all")
    chosen, text = (
        page.evaluate("window.store_view.chosen"),
        model(page, "selection", "value"),
    )
    labels = {"distance_m": "distance (m)", "mean_speed_mps": "mean speed (m/s)"}
    values = open_store(store).table([*labels]).to_pydict()
    for column, label in labels.items():
        change(page, "column-0", "value", column)
        page.wait_for_function(f"{MODEL}('rows').data.c0[0] === {values[column][0]!r}")
        first = next(
            n for n, speed in enumerate(values["mean_speed_mps"]) if speed <= 0.5
        )
        listed = f"{values[column][first]:.4f}".rstrip("0")
        page.get_by_text(listed).first.wait_for()  # in the table
        assert model(page, "cloud", "below[0].axis_label.text") == label
        assert page.evaluate("window.store_view.chosen") == chosen < len(values[column])
        assert model(page, "selection", "value") == text
    change(page, "selection", "value", "")


def test_columns_are_found_by_their_words(page: Any, store: Path) -> None:
    change(page, "find", "value_input", "knee swing rad")
    page.wait_for_function(
        f"{MODEL}('column-0').options.gait?.[0][1] === 'knee peak swing (rad)'"
    )
    assert model(page, "column-0", "value") == "mean_speed_mps"  # and still there
    change(page, "find", "value_input", "")


@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_nothing_is_cut_or_overlaps(page: Any, store: Path, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 1250})
    page.wait_for_timeout(1000)
    wide, apart, beside = page.evaluate(
        (ASSETS / "edges.js").read_text(encoding="utf-8")
    )
    page.set_viewport_size({"width": 1500, "height": 1250})
    assert wide <= width and apart and beside == (width > 1000)


def test_play_pause_and_scrub(page: Any, store: Path) -> None:
    change(page, "play", "active", False)
    change(page, "time", "value", 0.5)
    page.wait_for_function("window.walk_player.time === 0.5")
    page.wait_for_timeout(200)
    assert page.evaluate("window.walk_player.time") == 0.5
    page.keyboard.press("Space")
    page.wait_for_function(f"{MODEL}('play').active")
    page.keyboard.press("Space")
    change(page, "time", "value", 0.5)
    shown_s = float(model(page, "stage", "title.text").split(" s")[0])
    assert 0.5 - 1.0 / RATE_HZ - 0.01 < shown_s <= 0.5
    walks(page, lambda: change(page, "row", "value", 60))
    assert model(page, "time", "value") == 0.0  # where another walk begins
    change(page, "play", "active", True)
    page.wait_for_function("window.walk_player.time > 0.5")


def test_a_slider_changes_the_gait_within_its_bounds(page: Any, store: Path) -> None:
    walks(page, lambda: change(page, "start", "value", "reference"))
    before = page.evaluate(f"[...{MODEL}('stage-frames').data.near[0]]")
    walks(page, lambda: change(page, "gain-K_SOL", "value", 12.0))
    after = page.evaluate(f"[...{MODEL}('stage-frames').data.near[0]]")
    assert before != after
    assert model(page, "number-K_SOL", "value") == 12.0
    change(page, "part", "active", 1)
    page.wait_for_function(f"/<b>[+-]/.test({MODEL}('score')?.text)")
    change(page, "part", "active", 0)
    page.wait_for_function(f"{MODEL}('number-K_SOL') !== null")
    change(page, "number-K_SOL", "value", 99.0)
    page.wait_for_function(f"{MODEL}('message').text.includes('K_SOL: 99')")
    page.wait_for_function(f"{MODEL}('number-K_SOL').value === 12")
    walks(page, lambda: change(page, "number-K_SOL", "value", 10.0))
    assert model(page, "message", "text") == ""


@cases("out-of-bounds.toml", "field", "text", "said")
def test_out_of_bounds_is_said(
    page: Any, store: Path, field: str, text: str, said: str
) -> None:
    change(page, "part", "active", 0)
    page.wait_for_function(f"{MODEL}('number-K_SOL') !== null")
    held = model(page, field, "value") or 0
    # At the keyboard: fields round and clip what a hand on a model does not.
    view = f"Bokeh.index.query((view) => view.model.name === '{field}')"
    box = page.evaluate_handle(f"[...{view}][0].input_el").as_element()
    box.fill(text)
    box.press("Enter")
    page.wait_for_function(f"{MODEL}('message').text.includes({json.dumps(said)})")
    page.wait_for_timeout(500)
    assert said in model(page, "message", "text")  # still
    change(page, field, "value", held)


PLACES = asset("muscles-on-the-body.toml")
LEFT_AHEAD_S, RIGHT_AHEAD_S = 3.10, 3.64  # of the gait `reference`


def frames_until_now(page: Any) -> int:
    """How many frames of the walk have been shown, with that which is shown now."""
    times = page.evaluate(f"[...{MODEL}('stage-frames').data.time_s[0]]")
    now = page.evaluate("window.walk_player.time")
    return sum(time <= now + 1e-6 for time in times)


def on_the_body(page: Any, side: str, muscle: str) -> tuple[float, float]:
    """Where a muscle is in the stage's metres, now, by the bones that are drawn there."""
    place = PLACES[muscle]
    name = "near" if side == "left" else "far"
    frame = frames_until_now(page)
    points = page.evaluate(
        f"[...{MODEL}('stage-frames').data.{name}[0].slice({10 * frame - 10}, {10 * frame})]"
    )
    hip, knee, ankle = np.reshape(points, (5, 2))[:3]
    upper, lower = {"thigh": (hip, knee), "shank": (knee, ankle)}[place["bone"]]
    axis = (lower - upper) / np.hypot(*(lower - upper))
    front = np.array([-axis[1], axis[0]])
    x, z = upper + place["along_m"] * axis + place["ahead_m"] * front
    return float(x), float(z)


def stop_at(page: Any, moment_s: float) -> None:
    """Show a moment of a walk that is stopped: a frame that was under way may set another first."""
    page.wait_for_function(
        f"""() => {{
            if (window.walk_player.time === {moment_s}) return true
            {MODEL}('time').value = 0
            {MODEL}('time').value = {moment_s}
            return false
        }}"""
    )


@pytest.fixture(scope="module")
def standing(page: Any, store: Path) -> None:
    """The gait `reference`."""
    change(page, "part", "active", 0)
    page.wait_for_function(f"{MODEL}('start') !== null")
    walks(page, lambda: change(page, "start", "value", "reference"))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("muscle", PLACES)
def test_a_muscle_is_named_where_it_is(
    page: Any, standing: None, muscle: str, side: str
) -> None:
    """With its own activation and thickness; found by its place, not by its number."""
    change(page, "play", "active", False)
    behind = muscle == "HFL"  # seen best on the leg that is behind
    moment_s = LEFT_AHEAD_S if (side == "left") != behind else RIGHT_AHEAD_S
    stop_at(page, moment_s)
    page.mouse.move(*at(page, "stage", *on_the_body(page, side, muscle)))
    name = f"{side} {muscle}, {PLACES[muscle]['words']}: "
    page.wait_for_function(f"{MODEL}('stage').title.text.includes({json.dumps(name)})")
    told = float(model(page, "stage", "title.text").rpartition(": ")[2])
    walk, frame = the_walk(), frames_until_now(page)
    number = MUSCLES.index(muscle) + len(MUSCLES) * (side == "right")
    activation = walk.trajectory.activation[:, number]
    seconds = walk.frames["time_s"][frame - 1]
    expected = np.interp(seconds, walk.trajectory.time_s, activation)
    assert told == pytest.approx(expected, abs=0.02)
    lines = f"{MODEL}('stage').renderers.at(-1).data_source.data"
    metres = page.evaluate(f"{lines}.metres[{lines}.muscle.indexOf({number})]")
    assert metres == stick_figure.DRAWN[muscle]["belly_m"]
    change(page, "play", "active", True)


@cache
def the_walk() -> Walk:
    """What the page shows first, simulated here."""
    level = chosen_setting("flat", "nominal", 1, "nominal", "taichi", 10.0)
    return walk(gains_of_source("reference"), level)


def press(page: Any, step: str) -> int:
    """Click on words or a row, choose of a menu, or point at a muscle; these are so many clicks."""
    what, _, which = step.rpartition(": ")
    if what == "point":
        walks(page, lambda: page.mouse.click(*point(page, int(which))))
    elif what == "over":
        page.mouse.move(*at(page, "stage", *on_the_body(page, *which.split())))
    elif what:
        walks(page, lambda: page.get_by_label(what).select_option(which))
    else:
        page.get_by_text(step, exact=True).click()
    return {"": 1, "point": 1, "over": 0}.get(what, 2)


@cases("newcomer.toml", "steps", "sees")
def test_a_newcomer_finds_it_in_four_clicks(
    page: Any, store: Path, steps: list[str], sees: str
) -> None:
    assert sum(press(page, step) for step in steps) <= 4
    page.wait_for_function(sees.replace("NAMED", MODEL))


def test_data_keep_their_colours_at_night(page: Any, store: Path) -> None:
    left, top, width, height = frame(page, "cloud")
    inside = {"x": left + 3, "y": top + 3, "width": width - 6, "height": height - 6}
    by_day = page.screenshot(clip=inside)
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(300)
    by_night = page.screenshot(clip=inside)
    page.emulate_media(color_scheme="light")
    assert by_night == by_day


def test_the_selection_reads_back(page: Any, store: Path) -> None:
    change(page, "selection", "value", "mean_speed_mps 0..0.5")
    page.wait_for_timeout(300)
    with page.expect_download() as saved:
        page.get_by_text("selection as Parquet").click()
    whole, table = open_store(store).table(), pq.read_table(saved.value.path())
    assert table.equals(whole.filter(whole["mean_speed_mps"].to_numpy() <= 0.5))
    assert 0 < len(table) == page.evaluate("window.store_view.chosen") < len(whole)
    change(page, "selection", "value", "")


def test_a_tab_that_is_closed_leaves_others_alone(page: Any, store: Path) -> None:
    other = page.context.browser.new_page()
    other.goto(page.url)
    other.wait_for_function("window.store_view?.refreshed > 0")
    other.evaluate(f"{MODEL}('row').value = 3")
    other.close()
    walks(page, lambda: change(page, "row", "value", 5))
    page.get_by_text("store-row-5").first.wait_for()
    assert page.get_by_text("store-row-3").count() == 0  # which the other tab asked for


def test_a_store_that_is_being_filled(folders: Path, page: Any, tmp_path: Path) -> None:
    """The first shard is there, the manifest is not; then another one comes."""
    whole = tmp_path / "whole"
    fake_walker.write_store(whole, shard_rows=100)
    growing = tmp_path / "growing"
    growing.mkdir()
    shards = sorted(whole.glob("part-*.parquet"))
    assert len(shards) == 2
    for name in ("specification.json", shards[0].name):
        (growing / name).write_bytes((whole / name).read_bytes())
    with opened(page, growing) as address:
        page.wait_for_function("window.store_view?.chosen === 100")
        (growing / shards[1].name).write_bytes(shards[1].read_bytes())
        page.goto(address)
        page.wait_for_function("window.store_view?.chosen === 150")
        (growing / shards[1].name).write_bytes(b"damaged")
        page.goto(address)
        page.get_by_text("store: ").first.wait_for()


def test_a_head_of_the_table_sorts_all_rows(
    page: Any, folders: Path, tmp_path: Path
) -> None:
    """Not only those that the table lists: a store may have any number."""
    path = tmp_path / "many"
    fake_walker.write_store(path, samples=450)
    speeds = open_store(path).table(["mean_speed_mps"])["mean_speed_mps"].to_numpy()
    first = f"[...{MODEL}('listed').data.c0].slice(0, 200)"
    head = page.locator(".slick-header-column", has_text="mean speed")
    with opened(page, path):
        assert page.evaluate(first) == speeds[:200].tolist()
        for order, way in (
            (np.sort(speeds), "least"),
            (np.sort(speeds)[::-1], "largest"),
        ):
            head.click()
            told = f"450 of 450 rows; the table has the first 200 by mean speed (m/s), {way}"
            page.get_by_text(told).wait_for()
            assert page.evaluate(first) == order[:200].tolist()
            shown = page.locator(".slick-row").first.inner_text().split()
            assert float(shown[1]) == pytest.approx(order[0], abs=1e-4)
        walks(page, page.locator(".slick-row").first.click)
        fastest = speeds[page.evaluate(f"{MODEL}('row').value")]
        assert fastest == speeds.max()
        change(
            page, "selection", "value", "mean_speed_mps 0..0.5"
        )  # and of those selected
        page.wait_for_function("!window.store_view.all")
        below = np.sort(speeds[speeds <= 0.5])[::-1][:200]
        assert page.evaluate(first) == below.tolist()
        change(
            page, "column-0", "value", "distance_m"
        )  # other heads, which do not sort yet
        page.locator(".slick-header-column", has_text="distance").click()
        distances = open_store(path).table(["distance_m"])["distance_m"].to_numpy()
        least = np.sort(distances[speeds <= 0.5])[:200].tolist()
        page.wait_for_function(f"{MODEL}('listed').data.c0[0] === {least[0]!r}")
