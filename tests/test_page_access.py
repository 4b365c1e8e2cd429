"""axe-core finds nothing serious in any state of the page, light and dark."""

import importlib.util
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "page"))
from browsing import browser, draw, motion, needs_chromium, places, saved, server, until, visit  # noqa: E402, F401

pytestmark = needs_chromium

RUN = """async () => (await axe.run(document, {resultTypes: ['violations']})).violations
  .filter(v => ['serious', 'critical'].includes(v.impact)).flatMap(v => v.nodes.map(n => `${v.id}: ${n.html.slice(0, 160)} ${n.failureSummary}`))"""


@pytest.fixture(scope="module")
def axe() -> str:
    """axe-core's text, which axe-playwright-python carries."""
    package = importlib.util.find_spec("axe_playwright_python")
    assert package, "axe-core is missing: pip install -e '.[test]'"
    return (Path(package.origin).parent / "axe.min.js").read_text()


@pytest.fixture
def look(axe):
    """look(tab, state): nothing serious there, in light and in dark."""

    def look(tab, state: str):
        if not tab.evaluate("!!globalThis.axe"):
            tab.evaluate(f"() => {{ {axe}\n }}")
        for scheme in ("light", "dark"):
            tab.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            assert tab.evaluate(RUN) == [], f"{state}, {scheme}"

    return look


def test_drawing_learning_and_checking(visit, look):  # noqa: F811
    tab = visit("access")
    look(tab, "empty")
    draw(tab, 0, motion(0))
    look(tab, "drawn on one picture")
    draw(tab, 1, motion(1))
    tab.wait_for_selector("body[data-motion=shown]", timeout=60000)
    tab.keyboard.press("m")
    tab.mouse.click(*places(tab, 0, [motion(0)[12]])[0])
    tab.wait_for_selector("#marks:popover-open")
    look(tab, "learned, a mark offered")
    tab.keyboard.press("Escape")
    tab.keyboard.press("Escape")
    tab.evaluate("page.motion.weakest = {from: 0.2, to: 0.4, view: 'left'}, page.motion.warnings = ['A note.'], page.work.tellAll('s', ['A note.']), page.work.redrawOffered()")
    tab.keyboard.press("Control+Enter")
    tab.wait_for_selector("#verdict:not([hidden])")
    look(tab, "checked, and refused")
    tab.evaluate("document.querySelector('#verdict').dataset.mood = 'good', page.work.busy('Looking', 0.4), page.space.enlarge()")
    look(tab, "the motion in space, something going on")


def test_dialogs_and_menus(visit, look):  # noqa: F811
    tab = visit("dialogs")
    draw(tab, 0, motion(0))
    saved(tab)
    tab.click("#more")
    look(tab, "menu")
    tab.keyboard.press("Escape")
    for key, dialog in (("?", "keys"), ("l", "pictures"), ("a", "orbit"), ("n", "prompt"), ("Shift+Delete", "confirm")):
        tab.keyboard.press(key)
        tab.wait_for_selector(f"#{dialog}[open]")
        look(tab, dialog)
        tab.keyboard.press("Escape")
        tab.wait_for_selector(f"#{dialog}:not([open])", state="attached")
    for dialog in ("film", "farewell"):
        tab.evaluate(f"document.querySelector('#{dialog}').showModal()")
        look(tab, dialog)
        tab.evaluate(f"document.querySelector('#{dialog}').close()")


def test_what_goes_wrong(visit, look):  # noqa: F811
    tab = visit("wrong")
    draw(tab, 0, motion(0))
    saved(tab)
    tab.evaluate("page.work.tellAll('The server does not answer.', [], 'bad')")
    for state in ("conflict", "offline", "refused"):
        tab.evaluate(f"page.saver.be('{state}', new Error('The name is too long.'))")
        look(tab, state)
    tab.evaluate("page.saver.be('saved')")
