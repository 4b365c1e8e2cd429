"""Nothing that was drawn is lost or mixed: servers that are killed, tabs beside each other, files in and out."""

import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from teach.sketch import load

sys.path.insert(0, str(Path(__file__).parent / "page"))
pytest.register_assert_rewrite("browsing")
from browsing import LINE, Server, draw, motion, needs_chromium, saved, until  # noqa: E402

pytest_plugins = ["browsing"]
pytestmark = needs_chromium


def test_what_is_exported_is_imported_the_same(visit, tmp_path):
    tab = visit("exported")
    draw(tab, 0, LINE)
    draw(tab, 1, LINE - [0, 40])
    before = tab.evaluate("page.document.text()")
    for key, ending in (("Control+s", "json"), ("Control+Shift+S", "svg")):
        with tab.expect_download() as download:
            tab.keyboard.press(key)
        download.value.save_as(tmp_path / f"export.{ending}")
        tab.keyboard.press("Shift+X")
        tab.set_input_files("#file", tmp_path / f"export.{ending}")
        until(tab, f"document.querySelector('#says').textContent.startsWith('export.{ending} is imported')")
        assert json.loads(tab.evaluate("page.document.text()")) == json.loads(before), ending
    file = {"schema": "scene2skill.sketches", "version": 1, "sketches": json.loads(before)["sketches"]}
    camera, stroke = file["sketches"][0]["camera"], file["sketches"][0]["strokes"][0]
    for bad, words in (({"schema": "x"}, "a file of sketches"), (file | {"sketches": [{"view": "left", "camera": camera | {"K": [[1, 0, 0]]}, "strokes": []}]}, "sketches[0].camera"),
                       (file | {"sketches": [{"view": "left", "camera": camera, "strokes": [stroke | {"times": [0]}]}]}, "sketches[0].strokes[0]")):  # fmt: skip
        (tmp_path / "bad.json").write_text(json.dumps(bad))
        tab.set_input_files("#file", tmp_path / "bad.json")
        until(tab, f"document.querySelector('#says').textContent.includes('cannot be imported: ') && document.querySelector('#says').textContent.includes('{words}')")
        assert json.loads(tab.evaluate("page.document.text()")) == json.loads(before)


def test_a_skill_is_made_by_keys_alone_and_what_the_one_before_asked_for_is_not_shown_in_it(visit, server):
    tab = visit("before")
    draw(tab, 0, motion(0))
    draw(tab, 1, motion(1))
    saved(tab)
    tab.evaluate("page.work.fit(), page.setTool('select')")
    for name, then in (("a/b", "before"), ("Öffnen (2)", "Öffnen (2)")):
        tab.keyboard.press("n")
        tab.wait_for_selector("#prompt[open]")
        tab.keyboard.type(name)
        tab.keyboard.press("Enter")
        tab.wait_for_selector("#prompt:not([open])", state="attached")
        until(tab, f"page.name === '{then}'")
    until(tab, "page.tool === 'draw'")
    tab.wait_for_timeout(500)
    assert tab.evaluate("page.motion === null && page.document.all.length === 0 && document.querySelector('#busy').hidden")
    assert "from beginning to end" in tab.inner_text(".frame .hint >> nth=0")


def test_of_two_pages_on_one_skill_the_second_writer_is_told_and_nothing_is_lost(visit, server):
    one = visit("shared")
    two = visit("shared", context=one.context)
    one.bring_to_front()
    draw(one, 0, LINE)
    saved(one)
    two.bring_to_front()
    until(two, "page.document.all.length === 1")  # it follows as long as it has nothing of its own
    two.evaluate("page.saver.revision = 'an older one'")
    draw(two, 1, LINE)
    two.wait_for_selector("#conflict:not([hidden])")
    two.click("#keep-mine")
    two.wait_for_selector("#skills >> text=shared (mine)", state="attached")
    assert len(server.strokes("shared")) == 1 and len(server.strokes("shared (mine)")) == 2


def test_a_server_killed_between_strokes_loses_none(visit, tmp_path):
    server = Server(tmp_path / "killed")
    try:
        tab, rng = visit("killed", at=server), np.random.default_rng(0)
        for k in range(4):
            draw(tab, k % 2, LINE + [0, 9 * k])
            time.sleep(rng.uniform(0, 0.05))
            server.kill()
            draw(tab, k % 2, LINE - [0, 9 * k + 9])  # drawn while it is away
            server.start()
        saved(tab)
        assert len(server.strokes("killed")) == 8
        server.kill()
        draw(tab, 0, LINE)
        context = tab.context
        tab.close(run_before_unload=False)
        server.start()
        again = visit("killed", at=server, context=context)
        saved(again)
        assert len(server.strokes("killed")) == 9  # what a closed page could not save, the next one does
    finally:
        server.kill()


@pytest.mark.slow
def test_fifty_kills_at_any_moment_lose_no_finished_stroke_and_break_no_file(visit, tmp_path):
    server = Server(tmp_path / "killed")
    try:
        tab, rng = visit("often", at=server), np.random.default_rng(1)
        for k in range(50):
            draw(tab, k % 2, LINE + [0, k])
            time.sleep(rng.uniform(0, 0.06))
            server.kill()
            for path in (server.folder / "sketches").glob("*.json"):
                load(path)
            server.start()
        saved(tab)
        tab.wait_for_selector("#saving[data-state=saved]", timeout=20000)
        assert len(server.strokes("often")) == 50
    finally:
        server.kill()


@pytest.mark.slow
def test_twenty_tabs_drawing_at_once_mix_nothing(visit, server):
    first = visit("tab 0")
    tabs = [first, *(visit(f"tab {k}", context=first.context) for k in range(1, 20))]
    for _ in range(3):
        for k, tab in enumerate(tabs):  # saved by the page's own way, all at once: a background tab gets no frames to draw in
            tab.evaluate(f"page.document.addView(page.views[0].name, page.views[0].view.camera), page.document.add(page.views[0].name, {{points: [[{k}, 1], [{k}, 9]], times: [0, 1], demonstration: 0, kind: 'motion'}})")
    for tab in tabs:
        saved(tab)
    for k in range(20):
        strokes = server.strokes(f"tab {k}")
        assert len(strokes) == 3 and all((stroke.points[:, 0] == k).all() for stroke in strokes)
