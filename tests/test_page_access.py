"""Everything by keys, at any size, and nothing serious by axe-core in any state of the page, light and dark."""

import importlib.util
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "page"))
pytest.register_assert_rewrite("browsing")
from browsing import draw, motion, needs_chromium, places, saved, until  # noqa: E402

pytest_plugins = ["browsing"]
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


def test_drawing_learning_and_checking(visit, look):
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


def test_dialogs_and_menus(visit, look):
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


def test_what_goes_wrong(visit, look):
    tab = visit("wrong")
    draw(tab, 0, motion(0))
    saved(tab)
    tab.evaluate("page.work.tellAll('The server does not answer.', [], 'bad')")
    for state in ("conflict", "offline", "refused"):
        tab.evaluate(f"page.saver.be('{state}', new Error('The name is too long.'))")
        look(tab, state)
    tab.evaluate("page.saver.be('saved')")


def test_a_motion_can_be_drawn_by_keys_alone(visit, server):
    tab = visit("keys")
    for view in ("1", "2"):
        tab.keyboard.press(view)
        tab.keyboard.press("w")
        tab.keyboard.press("Enter")
        for _ in range(3):
            for _ in range(4):
                tab.keyboard.press("ArrowRight")
            tab.keyboard.press("ArrowUp")
            tab.keyboard.press("Enter")
        tab.keyboard.press("Enter")
    tab.keyboard.press("v")
    tab.keyboard.press("ArrowRight")
    tab.keyboard.press("c")
    saved(tab)
    strokes = server.strokes("keys")
    assert [len(stroke.points) for stroke in strokes] == [4, 4] and strokes[0].pointer == "waypoints"
    assert strokes[0].points[-1] - strokes[0].points[0] == pytest.approx([120, -30])
    assert [[event.name for event in stroke.events] for stroke in strokes] == [[], ["gripper_close"]]


def test_keys_reach_everything_all_is_named_and_nothing_is_cut_off_at_twice_the_size(visit):
    tab = visit("basics")
    reached = set()
    for _ in range(60):
        tab.keyboard.press("Tab")
        reached.add(tab.evaluate("document.activeElement.id || document.activeElement.title || document.activeElement.className"))
    shown = "[...document.querySelectorAll('button, select, input, canvas[tabindex], .frame')].filter(e => e.checkVisibility() && !e.disabled)"
    assert {*tab.evaluate(f"{shown}.map(e => e.id || e.title || e.className)")} <= reached
    assert tab.evaluate(f"{shown}.filter(e => !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length)).map(e => e.outerHTML)") == []
    for width, height in ((640, 400), (768, 1024)):
        tab.set_viewport_size({"width": width, "height": height})
        assert tab.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
        assert tab.evaluate("page.views.map(v => v.frame.clientWidth)")[0] >= 340


def test_every_command_has_a_key_of_its_own_that_the_list_names_and_none_breaks_the_page(visit):
    tab = visit("commands")
    draw(tab, 0, motion(0))
    draw(tab, 1, motion(1))
    tab.wait_for_selector("body[data-motion=shown]", timeout=60000)
    keys = tab.evaluate("[...document.querySelectorAll('#key-list kbd')].flatMap(k => k.textContent.split(', '))")
    assert len(keys) == len(set(keys)) > 45
    for key in keys:
        if key not in (",", "Ctrl+O"):  # the one moves the slider below; the other opens the system's own dialog
            tab.keyboard.press(key.replace("Ctrl", "Control"))
        tab.evaluate("document.querySelectorAll('dialog[open]').forEach(d => d.close()), document.querySelectorAll(':popover-open').forEach(p => p.hidePopover())")
    tab.evaluate("page.skills.open('commands')")
    until(tab, "page.name === 'commands' && page.saver.state === 'saved'")
    tab.evaluate("page.setTime(0.5)")
    tab.keyboard.press(",")
    assert tab.evaluate("page.clock.time") < 0.5
