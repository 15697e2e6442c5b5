"""The site of docs/: no warning, all links, every public name, notebooks, no network."""

import inspect
import json
import os
import posixpath
import re
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest

from study import pictures
from taichi_nmm import terrain
from tests.processes import python
from tests.test_public_doors import PACKAGES, public_names
from tests.tools.running import ROOT

REASON = "no site: pip install 'taichi-nmm[docs]'"
pytest.importorskip("material", reason=REASON)
pytest.importorskip("nbclient", reason=REASON)
mkdocstrings = pytest.importorskip("mkdocstrings", reason=REASON)

pytestmark = pytest.mark.slow

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
OUTSIDE = re.compile(r"\s*(\w+:)?//")
# Attributes of elements that a browser loads by itself.
LOADED = dict.fromkeys(
    ("script", "img", "iframe", "source", "video", "audio", "embed"), "src"
)
LOADED |= {"object": "data", "link": "href"}


class Html(HTMLParser):
    """The addresses that a page loads and links to, and its anchors."""

    def __init__(self, page):
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text())

    def handle_starttag(self, tag, attrs):
        given = {name: value or "" for name, value in attrs}
        if LOADED.get(tag) in given:
            self.loads.append(given[LOADED[tag]])
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        self.anchors |= {given[name] for name in ("id", "name") if name in given}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, which is built without a warning."""
    folder = tmp_path_factory.mktemp("site")
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    words = ("-m", "mkdocs", "build", "--strict", "--site-dir", folder)
    done = python(*words, env=environment)
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    assert [line for line in lines if not line.startswith("INFO ")] == []
    return folder


@pytest.fixture(scope="module")
def pages(site):
    """All pages by their place in the site."""
    return {
        page.relative_to(site).as_posix(): Html(page) for page in site.rglob("*.html")
    }


def public_paths():
    """Full names of what the packages offer: functions, classes and their members, constants."""
    owners = {name: package for package in PACKAGES for name in package.__all__}
    for package in (*PACKAGES, pictures):
        yield from (f"{package.__name__}.{name}" for name in package.__all__)
    yield from (
        f"{owners[name.partition('.')[0]].__name__}.{name}" for name in public_names()
    )
    for name, package in owners.items():
        members = (
            vars(value) if inspect.isclass(value := getattr(package, name)) else {}
        )
        for member, what in members.items():
            if isinstance(what, property) and not member.startswith("_"):
                yield f"{package.__name__}.{name}.{member}"
    for name, value in vars(terrain).items():
        makes = inspect.isfunction(value) and value.__annotations__.get("return")
        if makes is terrain.Terrain and not name.startswith("_"):
            yield f"{terrain.__name__}.{name}"


def test_every_public_name_has_its_entry(site):
    with (site / "objects.inv").open("rb") as file:
        entries = mkdocstrings.Inventory.parse_sphinx(file)
    names = set(public_paths())
    assert names > {
        "taichi_nmm.PUBLISHED_GAINS",
        "taichi_nmm.terrain.rough",
        "study.FeatureTable.from_arrays",
        "storage.Store.families",
    }
    assert names - set(entries) == set()


def test_links_lead_somewhere(site, pages):
    """Those of docstrings and of the theme, too."""
    links = [(place, link) for place, page in pages.items() for link in page.links]
    wrong = []
    for place, link in links:
        parts = urlsplit(link)
        is_anywhere = place == "404.html"  # where it is served
        if parts.scheme or parts.netloc or is_anywhere:
            continue
        file, anchor = unquote(parts.path), unquote(parts.fragment)
        there = posixpath.join(posixpath.dirname(place), file)
        target = posixpath.normpath(there) if file else place
        if not (site / target).is_file() or (
            anchor and anchor not in pages[target].anchors
        ):
            wrong.append(f"{place}: {link}")
    assert wrong == [] and len(links) > 1000


def test_nothing_is_loaded_from_elsewhere(site, pages):
    loads = [
        (place, address) for place, page in pages.items() for address in page.loads
    ]
    styles = [(str(file), file.read_text()) for file in site.rglob("*.css")]
    styles += [(place, (site / place).read_text()) for place in pages]
    for asks in (r"url\(\s*['\"]?([^)'\"]+)", r"@import\s+['\"]([^'\"]+)"):
        loads += [
            (place, found) for place, text in styles for found in re.findall(asks, text)
        ]
    assert len(loads) > 100
    assert [
        (place, address) for place, address in loads if OUTSIDE.match(address)
    ] == []
    # The theme would fetch what draws these.
    assert [
        place for place in pages if 'class="mermaid"' in (site / place).read_text()
    ] == []


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_its_output(notebook, site, pages):
    known = json.loads(notebook.read_text())["cells"]
    cells = [cell for cell in known if "outputs" in cell]
    for cell in cells:
        assert (cell["outputs"], cell["execution_count"]) == ([], None)
    sources = ["".join(cell["source"]) for cell in cells]
    place = f"notebooks/{notebook.stem}.html"
    drawn = [each for each in pages[place].loads if each.startswith(notebook.stem)]
    assert len(drawn) == sum("\nImage(" in source for source in sources) > 0
    for address in drawn:
        assert (site / "notebooks" / address).read_bytes().startswith(b"\x89PNG")
    text = (site / place).read_text()
    printing = sum("print(" in source for source in sources)
    assert text.count('class="language-text') >= printing > 0
    assert "Traceback" not in text


def test_it_is_searched_as_a_file(site, page):
    """As `make docs` leaves it: no server, no network."""
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((site / "notebooks" / "first_walk.html").as_uri())
    page.locator("input.md-search__input").click()
    page.keyboard.type("world_table")
    page.locator(".md-search-result__link").first.wait_for()
    assert [address for address in asked if not address.startswith("file:")] == []
