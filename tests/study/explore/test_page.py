"""The explorer as a person uses it: a headless Chromium on a store."""

import json
import re
from io import BytesIO
from shutil import copy

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from storage.store import columns_of, open_store
from storage.tables import document_hash, write_table
from study.experiment.gains import gains_of_source
from study.explore.signals import FIRST
from study.explore.store_view import read_selection
from study.explore.walk import RATE_HZ, chosen_setting, recorded, walk
from study.pictures import stick_figure, style
from study.pictures.trajectory_files import own_columns
from taichi_nmm.result import MUSCLES
from taichi_nmm.world import ACROSS_ANKLE
from tests.browser import PATIENCE_MS, opened_page
from tests.cases import ASSETS, asset, cases
from tests.storage.fake import content
from tests.study import fake_walker
from tests.study.explore.serving import change, opened, show_row, walks

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A store whose gains are real, and whose scores are a formula's."""
    pytest.importorskip("bokeh", reason="no bokeh: pip install 'taichi-nmm[explore]'")
    folder = tmp_path_factory.mktemp("explored")
    fake_walker.write_store(folder / "store")
    return folder


@pytest.fixture(scope="module")
def page():
    """Of this file alone: it is larger than others."""
    with opened_page(1500, 1250) as page:
        errors, asked = [], []
        page.on("console", lambda line: line.type == "error" and errors.append(line))
        page.on("request", lambda request: asked.append(request.url))
        yield page
        assert errors == []
        assert [
            url for url in asked if not re.match(".*://127.0.0.1:|blob:", url)
        ] == []


@pytest.fixture(scope="module")
def store(folders, page):
    """Opened in the page."""
    before = content(folders / "store")
    with opened(page, folders / "store"):
        yield folders / "store"
    assert content(folders / "store") == before  # nothing was written


SCRIPT = "<img src=x onerror=window.ran=1>"
TEX = r"$$\href{javascript:window.ran=1}{onerror}$$"


def test_names_of_a_file_are_text(page, folders, tmp_path):
    """A store comes from anybody: what its columns are called is shown and never run."""
    store = open_store(folders / "store")
    table = store.table()
    names = [f"{name}_survived_fraction_mean" for name in (SCRIPT, TEX)]
    for name in names:
        table = table.append_column(name, table["mean_speed_mps"])
    specification = store.specification | {"columns": columns_of(table.schema)}
    footer = store.footers[0] | {"rows": len(table), "specification": specification}
    footer["specification_hash"] = document_hash(specification)
    hostile = tmp_path / f"{SCRIPT}.parquet"
    write_table(hostile, table, footer)
    with opened(page, hostile):
        for slot, name in enumerate((*names, *names, names[0])):
            change(page, f"column-{slot}", "value", name)
        page.wait_for_function("named('column-4').value.includes('onerror')")
        for name in (SCRIPT, TEX):
            change(page, "selection", "value", f"{name} 0..1")
            page.get_by_text(f"selection: {repr(name)[:9]}").wait_for()  # the message
        drawn = page.evaluate(
            "[...Bokeh.index.query((view) => view.model.type === 'LinearAxis')]"
            ".map((one) => one._axis_label_view?.model.type)"
        )
        assert "PlainText" in drawn and "TeX" not in drawn
        headings = page.locator(".slick-column-name").all_inner_texts()
        assert sum("onerror" in heading for heading in headings) == 5
        assert page.evaluate("window.ran") is None


def drag(page, name, start, end):
    """Draw a box in a figure: corners as shares of what lies within its axes."""
    left, top, width, height = page.evaluate("axes_of", name)
    page.mouse.move(left + start[0] * width, top + start[1] * height)
    page.mouse.down()
    page.mouse.move(left + end[0] * width, top + end[1] * height, steps=3)
    page.mouse.up()


DOUBLE_CLICK_MS = 600  # a second click of a browser within 300 ms is a part of one


def click_on_point(page, row):
    """Click on a row where it is in the cloud; it walks."""
    walks(page, lambda: page.mouse.click(*page.evaluate("point_of", row)))


def select(page, text):
    change(page, "selection", "value", text)


SLOW = "mean_speed_mps 0..0.5"
"""A selection of some of the rows."""


def speeds_of(store):
    return open_store(store).table(["mean_speed_mps"])["mean_speed_mps"].to_numpy()


def look_at(page, part, model):
    """Turn to a part of the walk's panel, until a model of it is there."""
    page.get_by_role("button", name=part, exact=True).click()
    page.wait_for_function("(model) => named(model) !== null", arg=model)


def test_a_store_opens_with_all_its_rows(page, store):
    rows = len(open_store(store))
    assert page.evaluate("window.store_view.chosen") == rows == fake_walker.STORE_ROWS
    assert page.evaluate("named('count').text") == f"{rows} of {rows} rows"
    image = "named('cloud').renderers[0].data_source.data.image[0]"
    assert page.evaluate(f"{image}.some((pixel) => pixel !== 0)")
    step_length = page.evaluate("named('column-4').description")
    assert "from the other ankle to that of the foot that strikes" in step_length


def test_a_brush_filters_the_table_and_the_histograms(page, store):
    drag(page, "cloud", (0.3, 0.05), (0.9, 0.95))
    page.wait_for_function("named('selection').value !== ''")
    page.wait_for_function("window.store_view.chosen < window.store_view.inside.length")
    chosen = page.evaluate("window.store_view.chosen")
    text = page.evaluate("named('selection').value")
    ranges = read_selection(text, ("mean_speed_mps", "phi_printed"))
    low, high = ranges["mean_speed_mps"]
    speeds = page.evaluate("[...named('listed').data.c0]")
    assert 0 < len(speeds) == min(chosen, 200)
    assert all(low <= value <= high for value in speeds)
    bars = "named('histogram-1').renderers[1].data_source.data.top"
    assert page.evaluate(f"{bars}.reduce((sum, bar) => sum + bar)") == chosen
    drag(page, "histogram-1", (0.0, 0.5), (0.5, 0.5))
    page.wait_for_function("(text) => named('selection').value !== text", arg=text)
    page.wait_for_function(f"window.store_view.chosen < {chosen}")


def test_a_typed_selection_filters_too(page, store):
    select(page, SLOW)
    speeds = speeds_of(store)
    slow = speeds[speeds <= 0.5]
    page.get_by_text(f"{len(slow)} of {len(speeds)} rows").wait_for()
    assert page.evaluate("window.store_view.chosen") == len(slow)
    listed = page.locator(".slick-row").first.inner_text()
    assert float(listed.split()[1]) == pytest.approx(slow[0], abs=1e-4)
    select(page, "speed of light")
    message = "named('selection-message').text"
    page.wait_for_function(f"{message}.includes('column low..high')")
    assert page.evaluate("window.store_view.all")  # and nothing is selected by it
    select(page, "")
    page.wait_for_function(f"{message} === ''")


def test_a_click_walks_and_is_marked(page, store):
    show_row(page, 17)
    page.get_by_text("store-row-17").first.wait_for()
    stage = {"x": 720, "y": 180, "width": 740, "height": 400}
    first, time = page.screenshot(clip=stage), page.evaluate("window.walk_player.time")
    page.wait_for_function(f"window.walk_player.time !== {time}")
    # The walk repeats: one later picture may be as the first, all of them cannot.
    later = (
        page.wait_for_timeout(170) or page.screenshot(clip=stage) for _ in range(8)
    )
    assert any(picture != first for picture in later)
    click_on_point(page, 40)
    row = page.evaluate("named('row').value")
    shown = page.evaluate("columns_of", row)
    assert row != 17
    x, y = (page.evaluate(f"named('rings').data.{axis}[0]") for axis in "xy")
    assert [x, y] == shown[:2]
    spans = "named(`histogram-${slot}`).center.filter(({type}) => type === 'Span')"
    marks = f"[0, 1, 2, 3, 4].map((slot) => {spans}[0].location)"
    assert page.evaluate(marks) == shown
    marked = "named('listed').data.row[named('listed').selected.indices[0]]"
    assert page.evaluate(marked) == row
    page.wait_for_timeout(DOUBLE_CLICK_MS)
    click_on_point(page, row)  # again
    walks(page, page.locator(".slick-cell.selected").first.click)


def test_another_column_is_drawn_and_ranges_last(page, store):
    select(page, SLOW)
    page.wait_for_function("!window.store_view.all")
    chosen = page.evaluate("window.store_view.chosen")
    labels = {"distance_m": "distance (m)", "mean_speed_mps": "mean speed (m/s)"}
    values = open_store(store).numpy([*labels])
    first = np.flatnonzero(values["mean_speed_mps"] <= 0.5)[0]
    for column, label in labels.items():
        numbers = values[column].tolist()
        change(page, "column-0", "value", column)
        page.wait_for_function(f"named('rows').data.c0[0] === {numbers[0]!r}")
        listed = f"{numbers[first]:.4f}".rstrip("0")
        page.get_by_text(listed).first.wait_for()  # in the table
        assert page.evaluate("named('cloud').below[0].axis_label.text") == label
        assert page.evaluate("window.store_view.chosen") == chosen < len(numbers)
        assert page.evaluate("named('selection').value") == SLOW
    select(page, "")


def test_columns_are_found_by_their_words(page, store):
    change(page, "find", "value_input", "knee swing rad")
    first = "named('column-0').options.gait?.[0][1]"
    page.wait_for_function(f"{first} === 'knee peak swing (rad)'")
    assert page.evaluate("named('column-0').value") == "mean_speed_mps"  # and still
    change(page, "find", "value_input", "")


@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_nothing_is_cut_or_overlaps(page, store, width):
    page.set_viewport_size({"width": width, "height": 1250})
    page.wait_for_timeout(1000)
    edges = (ASSETS / "edges.js").read_text(encoding="utf-8")
    wide, apart, beside = page.evaluate(edges)
    page.set_viewport_size({"width": 1500, "height": 1250})
    assert wide <= width and apart and beside == (width > 1000)


def test_a_figure_hides_what_bokeh_does_not_clear(page, store):
    """Its outermost pixels, where parts of an earlier size stay: at night no paper is there."""
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(300)
    cloud = page.evaluate_handle("view_of('cloud').el").as_element()
    pixels = np.asarray(Image.open(BytesIO(cloud.screenshot())).convert("L"))
    page.emulate_media(color_scheme="light")
    assert pixels[:, 0].max() < 50 and pixels[0].max() < 50
    assert pixels[1:-2, 3:5].min() == 255


def test_play_pause_and_scrub(page, store):
    change(page, "play", "active", False)
    change(page, "time", "value", 0.5)
    page.wait_for_function("window.walk_player.time === 0.5")
    page.wait_for_timeout(200)
    assert page.evaluate("window.walk_player.time") == 0.5
    page.keyboard.press("Space")
    page.wait_for_function("named('play').active")
    page.keyboard.press("Space")
    change(page, "time", "value", 0.5)
    shown_s = float(page.evaluate("named('stage').title.text").split(" s")[0])
    assert 0.5 - 1.0 / RATE_HZ - 0.01 < shown_s <= 0.5
    show_row(page, 60)
    assert page.evaluate("named('time').value") == 0.0  # where another walk begins
    change(page, "play", "active", True)
    page.wait_for_function("window.walk_player.time > 0.5")


def test_a_slider_changes_the_gait_within_its_bounds(page, store):
    walks(page, lambda: change(page, "start", "value", "reference"))
    leg = "[...named('stage-frames').data.near[0]]"
    before = page.evaluate(leg)
    walks(page, lambda: change(page, "gain-K_SOL", "value", 12.0))
    assert page.evaluate(leg) != before
    assert page.evaluate("named('number-K_SOL').value") == 12.0
    look_at(page, "score", "score")
    page.wait_for_function("/<b>[+-]/.test(named('score').text)")
    look_at(page, "gains", "number-K_SOL")
    change(page, "number-K_SOL", "value", 99.0)
    page.wait_for_function("named('gains-message').text.includes('K_SOL: 99')")
    page.wait_for_function("named('number-K_SOL').value === 12")
    walks(page, lambda: change(page, "number-K_SOL", "value", 10.0))
    assert page.evaluate("named('gains-message').text") == ""


@cases("out-of-bounds.toml", "field", "text", "line", "said")
def test_out_of_bounds_is_said(page, store, field, text, line, said):
    look_at(page, "gains", "number-K_SOL")
    held = page.evaluate(f"named('{field}').value") or 0
    # At the keyboard: fields round and clip what a hand on a model does not.
    box = page.evaluate_handle(f"view_of('{field}').input_el").as_element()
    box.fill(text)
    box.press("Enter")
    there = "([line, said]) => named(line).text.includes(said)"
    page.wait_for_function(there, arg=[line, said])
    page.wait_for_timeout(500)
    assert said in page.evaluate(f"named('{line}').text")  # still
    change(page, field, "value", held)


PLACES = asset("muscles-on-the-body.toml")
LEFT_AHEAD_S, RIGHT_AHEAD_S = 3.10, 3.64  # of the gait `reference`


def muscle_place(page, side, muscle):
    """Where a muscle is now on the stage, m, by the bones that are drawn there."""
    place = PLACES[muscle]
    points = page.evaluate("bones_of", "near" if side == "left" else "far")
    hip, knee, ankle, *_ = np.reshape(points, (5, 2))
    upper, lower = {"thigh": (hip, knee), "shank": (knee, ankle)}[place["bone"]]
    axis = (lower - upper) / np.hypot(*(lower - upper))
    front = np.array([-axis[1], axis[0]])
    x, z = upper + place["along_m"] * axis + place["ahead_m"] * front
    return float(x), float(z)


def point_at(page, side, muscle):
    """Move the mouse to a muscle."""
    place = muscle_place(page, side, muscle)
    page.evaluate("painted")
    page.mouse.move(*page.evaluate("place_of", ["stage", *place]))


@pytest.fixture(scope="module")
def standing(page, store):
    """The gait `reference`."""
    look_at(page, "gains", "start")
    walks(page, lambda: change(page, "start", "value", "reference"))
    page.get_by_text("reference", exact=True).first.wait_for()


@pytest.fixture(scope="module")
def the_walk():
    """What the page shows first, simulated here."""
    level = chosen_setting(
        ground="flat",
        disturbance="nominal",
        seed=1,
        world="nominal",
        engine="taichi",
        duration_s=10.0,
    )
    return walk(gains_of_source("reference"), level)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("muscle", PLACES)
def test_a_muscle_is_named_where_it_is(page, standing, the_walk, muscle, side):
    """With its own activation and thickness; found by its place, not by its number."""
    change(page, "play", "active", False)
    behind = muscle == "HFL"  # seen best on the leg that is behind
    moment_s = LEFT_AHEAD_S if (side == "left") != behind else RIGHT_AHEAD_S
    page.wait_for_function("stopped_at", arg=moment_s)
    point_at(page, side, muscle)
    title = "named('stage').title.text"
    name = f"{side} {muscle}, {PLACES[muscle]['words']}: "
    page.wait_for_function(f"{title}.includes({json.dumps(name)})")
    told = float(page.evaluate(title).rpartition(": ")[2])
    number = MUSCLES.index(muscle) + len(MUSCLES) * (side == "right")
    seconds = the_walk.frames["time_s"][page.evaluate("frames_shown()") - 1]
    trajectory = the_walk.trajectory
    activation = trajectory.activation[:, number]
    expected = np.interp(seconds, trajectory.time_s, activation)
    assert told == pytest.approx(expected, abs=0.02)
    lines = "named('stage').renderers.at(-1).data_source.data"
    metres = page.evaluate(f"{lines}.metres[{lines}.muscle.indexOf({number})]")
    assert metres == stick_figure.DRAWN[muscle]["belly_m"]
    change(page, "play", "active", True)


def press(page, step):
    """Click on words or a row, choose of a menu, or point at a muscle; these are so many clicks."""
    what, _, which = step.rpartition(": ")
    if what == "point":
        click_on_point(page, int(which))
        return 1
    if what == "over":
        point_at(page, *which.split())
        return 0
    if what:
        walks(page, lambda: page.get_by_label(what).select_option(which))
        return 2
    page.get_by_text(step, exact=True).click()
    return 1


@cases("newcomer.toml", "steps", "sees")
def test_a_newcomer_finds_it_in_four_clicks(page, store, steps, sees):
    assert sum(press(page, step) for step in steps) <= 4
    page.wait_for_function(sees)


def test_signals_are_found_by_typing(page, store, the_walk):
    """Two are there at first; a third is drawn over the stride, with the muscle of people."""
    look_at(page, "gains", "start")
    walks(page, lambda: change(page, "start", "value", "reference"))
    change(page, "duration", "value", "10 s")  # as `the_walk`
    look_at(page, "signals", "signals")
    page.wait_for_function("named('signals-1-signal')?.data.y.length === 2000")
    columns = own_columns(recorded(the_walk, 0)[0])
    page.wait_for_function("named('signal-words').text === 'blue: reference'")
    for slot, name in enumerate(FIRST):
        drawn = page.evaluate(f"[...named('signals-{slot}-signal').data.y]")
        assert drawn == columns[name].tolist()
        assert page.evaluate(f"named('signals-{slot}').tags[1]") == name
    field = page.evaluate_handle("view_of('signals').shadow_el.querySelector('input')")
    field.as_element().click()
    page.keyboard.type("left sol activ")
    page.wait_for_timeout(300)  # it searches as one types
    page.keyboard.press("Enter")
    page.wait_for_function("named('signals-2').tags[1] === 'l_SOL_activation'")
    page.get_by_text("over the stride", exact=True).click()
    page.wait_for_function("named('signals-2-on').data.x.length === 4")
    page.wait_for_function("named('signals-2').inner_width > 100")
    page.wait_for_function(
        "walk_player.lines.some(([, , {name}]) => name === 'signals-2')"
    )


def test_what_if_a_muscle_is_weak(page, store):
    """It walks at once, and lines that cannot be used leave it."""
    look_at(page, "gains", "start")
    walks(page, lambda: change(page, "start", "value", "reference"))
    look_at(page, "what if", "lines")
    walks(page, lambda: change(page, "world.muscles.SOL_left", "value", 0.5))
    assert page.evaluate("named('lines').value") == "[world.muscles]\nSOL_left = 0.5"
    assert page.evaluate("named('fall-0').data.words.length") == 1
    seen = page.evaluate("window.walk_player.shown")
    change(page, "lines", "value", "world.muscles.SOL_left = 20")
    page.wait_for_function("/SOL_left: 20 /.test(named('what-if-message').text)")
    assert page.evaluate("window.walk_player.shown") == seen
    ground = page.evaluate_handle("view_of('ground-file').input_el").as_element()
    hill = b"x_m,height_m\n0,0\n1,0\n2,0.3\n"
    sent = {"name": "hill.csv", "mimeType": "text/csv", "buffer": hill}
    ground.set_input_files(sent | {"buffer": hill.ljust(15_000_001)})
    page.wait_for_function("/at most 15 MB/.test(named('what-if-message').text)")
    walks(page, lambda: ground.set_input_files(sent))
    heights = "[...named('stage-frames').data.ground[0]].filter((_, i) => i % 2)"
    page.wait_for_function(f"Math.abs(Math.max(...{heights}) - 0.3) < 1e-6")
    walks(page, page.get_by_text("none of this").click)
    walks(page, lambda: change(page, "ground", "value", "flat"))
    change(page, "duration", "value", "10 s")


def test_a_prosthesis_and_a_device_are_on_the_stage(page, store):
    """Pylon and foot on the left in place of half the shank; struts about the right ankle."""
    worn = """[world]
        prosthesis = { side = "left", stiffness_nmprad = 350.0, damping_nmsprad = 1.0 }
        exoskeleton = { motion = "plantarflexion", side = "right" }"""
    look_at(page, "what if", "lines")
    walks(page, lambda: change(page, "lines", "value", worn))
    look_at(page, "gains", "number-exo_torque")
    page.wait_for_timeout(1000)  # a slider that is just being drawn takes its old value
    walks(page, lambda: change(page, "number-exo_torque", "value", 40.0))
    change(page, "play", "active", False)
    page.wait_for_function("stopped_at", arg=0.5)
    drawn = page.evaluate("drawn_in", [style.DEVICE, style.TORQUE])
    assert [key for key, _ in drawn if key != "arrows"] == ["struts"] * 2 + ["near"] * 2
    *_, foot, pylon = (line for key, line in drawn if key != "arrows")
    _, knee, ankle, heel, ball = np.reshape(page.evaluate("bones_of", "near"), (5, 2))
    assert pylon == pytest.approx([*(0.5 * (knee + ankle)), *ankle], abs=1e-4)
    assert foot == pytest.approx([*heel, *ball], abs=1e-4)
    frames = "named('stage-frames').data"
    shown = page.evaluate(f"{frames}.muscles[0].slice(0, 14 * 30).map(isFinite)")
    muscles = np.reshape(shown, (14, 30)).all(axis=1).tolist()
    assert muscles == [muscle not in ACROSS_ANKLE for muscle in MUSCLES] + [True] * 7
    assert page.evaluate(f"{frames}.arrows[0].some(isFinite)")
    walks(page, lambda: change(page, "number-exo_torque", "value", 0.0))
    assert len(page.evaluate("drawn_in", [style.DEVICE, style.TORQUE])) == 2
    look_at(page, "what if", "lines")
    walks(page, page.get_by_text("none of this").click)
    assert page.evaluate("drawn_in", [style.DEVICE, style.TORQUE]) == []
    change(page, "play", "active", True)


def test_data_keep_their_colours_at_night(page, store):
    left, top, width, height = page.evaluate("axes_of", "cloud")
    inside = {"x": left + 3, "y": top + 3, "width": width - 6, "height": height - 6}
    by_day = page.screenshot(clip=inside)
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(300)
    by_night = page.screenshot(clip=inside)
    page.emulate_media(color_scheme="light")
    assert by_night == by_day


def test_the_selection_reads_back(page, store):
    select(page, SLOW)
    page.wait_for_timeout(300)
    with page.expect_download() as saved:
        page.get_by_text("selection as Parquet").click()
    whole, table = open_store(store).table(), pq.read_table(saved.value.path())
    assert table.equals(whole.filter(speeds_of(store) <= 0.5))
    assert 0 < len(table) == page.evaluate("window.store_view.chosen") < len(whole)
    select(page, "")


def test_a_phone_shows_the_walker_first_and_is_tapped(page, store):
    """A tap on a point lets it walk, a tap on a muscle names it."""
    context = page.context.browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True
    )
    phone = context.new_page()
    phone.set_default_timeout(PATIENCE_MS)
    phone.add_init_script(path=ASSETS / "hands.js")
    phone.goto(page.url)
    phone.wait_for_function(
        "window.store_view?.refreshed > 0 && window.walk_player?.shown > 0"
    )
    phone.wait_for_timeout(1000)  # it has been laid out
    _, top, _, height = phone.evaluate("axes_of", "stage")
    assert top > 0 and top + height < 844
    change(phone, "play", "active", False)
    phone.wait_for_function("stopped_at", arg=LEFT_AHEAD_S)
    phone.wait_for_timeout(300)
    x, y = phone.evaluate("place_of", ["stage", *muscle_place(phone, "left", "VAS")])
    phone.touchscreen.tap(x, y)
    phone.wait_for_function("named('stage').title.text.includes('left VAS, ')")
    phone.evaluate("view_of('cloud').el.scrollIntoView()")
    walks(phone, lambda: phone.touchscreen.tap(*phone.evaluate("point_of", 40)))
    assert phone.evaluate("named('row').value") is not None
    context.close()


def test_a_tab_that_is_closed_leaves_others_alone(page, store):
    other = page.context.browser.new_page()
    other.goto(page.url)
    other.wait_for_function("window.store_view?.refreshed > 0")
    other.evaluate("Bokeh.documents[0].get_model_by_name('row').value = 3")
    other.close()
    show_row(page, 5)
    page.get_by_text("store-row-5").first.wait_for()
    assert page.get_by_text("store-row-3").count() == 0  # which the other tab asked for


def test_a_store_that_is_being_filled(folders, page, tmp_path):
    """The first shard is there, the manifest is not; then another one comes."""
    whole = tmp_path / "whole"
    fake_walker.write_store(whole, shard_rows=100)
    growing = tmp_path / "growing"
    growing.mkdir()
    first, second = sorted(whole.glob("part-*.parquet"))
    for part in (whole / "specification.json", first):
        copy(part, growing)
    with opened(page, growing) as address:
        page.wait_for_function("window.store_view?.chosen === 100")
        copy(second, growing)
        page.goto(address)
        page.wait_for_function("window.store_view?.chosen === 150")
        (growing / second.name).write_bytes(b"damaged")
        page.goto(address)
        page.get_by_text("store: ").first.wait_for()
        assert page.title() == str(growing)


def test_a_head_of_the_table_sorts_all_rows(page, folders, tmp_path):
    """Not only those that the table lists: a store may have any number."""
    path = tmp_path / "many"
    fake_walker.write_store(path, samples=450)
    speeds = speeds_of(path)
    listed = "[...named('listed').data.c0].slice(0, 200)"
    head = page.locator(".slick-header-column", has_text="mean speed")
    with opened(page, path):
        assert page.evaluate(listed) == speeds[:200].tolist()
        ways = {"least": np.sort(speeds), "largest": np.sort(speeds)[::-1]}
        for way, order in ways.items():
            head.click()
            told = f"450 of 450 rows; the table has the first 200 by mean speed (m/s), {way}"
            page.get_by_text(told).wait_for()
            assert page.evaluate(listed) == order[:200].tolist()
            shown = page.locator(".slick-row").first.inner_text().split()
            assert float(shown[1]) == pytest.approx(order[0], abs=1e-4)
        walks(page, page.locator(".slick-row").first.click)
        assert speeds[page.evaluate("named('row').value")] == speeds.max()
        select(page, SLOW)  # and of those selected
        page.wait_for_function("!window.store_view.all")
        slow = speeds <= 0.5
        below = np.sort(speeds[slow])[::-1][:200]
        assert page.evaluate(listed) == below.tolist()
        # Other heads, which do not sort yet.
        change(page, "column-0", "value", "distance_m")
        page.locator(".slick-header-column", has_text="distance").click()
        distances = open_store(path).numpy(["distance_m"])["distance_m"][slow]
        least = float(distances.min())
        page.wait_for_function(f"named('listed').data.c0[0] === {least!r}")
