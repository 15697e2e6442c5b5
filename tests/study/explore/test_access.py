"""The explorer for everybody: axe-core, which tries the rules of WCAG, finds nothing serious."""

import pytest

from tests.browser import opened_page
from tests.study import fake_walker
from tests.study.explore.serving import opened

pytestmark = pytest.mark.slow

SERIOUS = ("serious", "critical")
PARTS = {  # with a model of each
    "gains": "number-K_SOL",
    "what if": "lines",
    "score": "score",
    "signals": "signals",
    "stride beside people": "cycle",
    "take it with you": "command",
}
# At night widgets are inverted by a filter, of which axe-core's contrasts know nothing.
UNFILTERED = {"rules": {"color-contrast": {"enabled": False}}}


def test_nothing_serious_is_found(tmp_path):
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright",
        reason="no axe-core: pip install 'taichi-nmm[test]'",
    ).Axe()
    fake_walker.write_store(tmp_path / "store")
    with opened_page(1280, 1000) as page, opened(page, tmp_path / "store"):

        def found(options=None):
            page.wait_for_timeout(1000)  # names are given twice a second
            broken = axe.run(page, options=options).response["violations"]
            return [
                f"{each['id']}: {[node['html'] for node in each['nodes']]}"
                for each in broken
                if each["impact"] in SERIOUS
            ]

        for part, model in PARTS.items():
            page.get_by_role("button", name=part, exact=True).click()
            page.wait_for_function("(model) => named(model) !== null", arg=model)
            assert found() == [], part
        for width in (390, 1920):
            page.set_viewport_size({"width": width, "height": 1000})
            assert found() == [], width
        page.emulate_media(color_scheme="dark")
        assert found(UNFILTERED) == []
        page.evaluate("document.documentElement.removeAttribute('lang')")
        assert [each for each in found(UNFILTERED) if each.startswith("html-has-lang")]
