"""A person's two minutes, in a real browser: every pointer event is Chromium's own."""

import json
import sys
import time
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scene.camera import Camera
from teach.sketch import load

sys.path.insert(0, str(Path(__file__).parent / "page"))
from browsing import Server, browser, draw, motion, needs_chromium, places, saved, server, until, visit  # noqa: E402, F401
from serve import CORNER, VIEWS  # noqa: E402

pytestmark = needs_chromium

LINE = np.column_stack([np.linspace(150, 480, 25), 260 + 60 * np.sin(np.linspace(0, 4, 25))])


FINE = np.linspace(0, 1, 400)[:, None]


def test_a_motion_drawn_on_two_pictures_is_learned_checked_and_handed_on(visit, server):
    tab = visit("reach")
    assert "Draw the motion" in tab.inner_text("#sentence")
    draw(tab, 0, motion(0))
    assert "second picture" in tab.inner_text("#sentence")
    draw(tab, 1, motion(1))
    tab.wait_for_selector("body[data-motion=shown]", timeout=60000)
    assert "known to about" in tab.inner_text("#sentence")
    learned = np.array(tab.evaluate("page.motion.ways[0].mean"))
    meant = np.hstack([0.1 * np.sin(3 * FINE), 0.5 * FINE - 0.25, 0.05 + 0.5 * FINE * (1 - FINE)])
    off = np.linalg.norm(learned[:, None] - meant, axis=2).min(axis=1)  # whatever the speed at which a busy machine moved the mouse
    assert np.median(off) < 0.05 and off.max() < 0.08, off.max()  # a single stroke a view
    np.testing.assert_allclose(learned[[0, -1], 1], [-0.25, 0.25], atol=0.05)
    tab.click("#act >> text=Check")
    tab.wait_for_selector("#verdict:not([hidden])")
    assert tab.inner_text("#verdict") == "The arm cannot do it: the mean: finger touches cup at 40 %."
    tab.click("#act >> text=Done")
    tab.wait_for_selector("#farewell[open]")
    assert (server.folder / "done").read_text() == "reach"
    assert [len(load(server.folder / "sketches" / "reach.json")[k].strokes) for k in range(2)] == [1, 1]


ARM = """() => {
  const {space} = page
  space.paintNow()
  const {raster: {width, height, pixels, kept: [still]}} = space, sum = [0, 0, 0]
  pixels.forEach((c, i) => { if (c !== still[i]) { sum[0] += i % width; sum[1] += Math.floor(i / width); sum[2]++ } })
  return {at: [sum[0] / sum[2] / width, sum[1] / sum[2] / height], camera: space.camera(width, height)}
}"""


def test_the_arm_performs_in_space_what_was_checked_at_the_moment_of_the_slider(visit):
    tab = visit("space")
    until(tab, "!!(page.space.mesh && page.space.arm)")
    shown = lambda: tab.evaluate(ARM)

    def where(place, point):
        seen = place["camera"]
        pixel = Camera(seen["K"], seen["world_from_camera"], seen["width"], seen["height"]).project(np.array(point))
        return pixel / [seen["width"], seen["height"]]

    tab.evaluate("page.work.changed = () => {}")
    np.testing.assert_allclose((place := shown())["at"], where(place, [0, -0.3, 0.1]), atol=0.02)
    draw(tab, 0, motion(0))
    draw(tab, 1, motion(1))
    saved(tab)
    tab.evaluate("page.work.fit()")
    tab.wait_for_selector("body[data-motion=shown]", timeout=60000)
    tab.click("#act >> text=Check")
    tab.wait_for_selector("#verdict:not([hidden])")
    for t in (0, 0.5, 1):
        tab.evaluate(f"page.setTime({t})")
        np.testing.assert_allclose((place := shown())["at"], where(place, [0, 0.4 * t - 0.2, 0.1]), atol=0.02)
    assert tab.inner_text("#clock") == "3.0 s"
    tab.keyboard.press("Space")
    until(tab, "page.clock.time > 0.05 && page.clock.time < 1")
    tab.keyboard.press("3")
    tab.keyboard.press("f")
    until(tab, "page.space.canvas.clientHeight > 300")
    before = tab.evaluate("page.space.table.place.azimuth")
    tab.keyboard.press("ArrowRight")
    assert tab.evaluate("page.space.table.place.azimuth") != before


def test_the_hand_points_along_an_arrow_drawn_on_two_pictures_and_undo_takes_it_back(visit, server):
    tab = visit("hand")
    draw(tab, 0, motion(0))
    draw(tab, 1, motion(1))
    direction, tail = np.array([0.5, 0.0, -0.85]), np.array([0.0, 0.1, 0.35])
    ends = [list(VIEWS.values())[k].project(tail + np.array([[0.0], [0.5], [1.0]]) * 0.2 * direction) for k in range(2)]
    tab.select_option("#hand", "along")
    assert "Draw an arrow" in tab.inner_text("#says") and tab.evaluate("page.tool") == "arrow"
    draw(tab, 0, ends[0])
    assert "second picture" in tab.inner_text("#says")
    until(tab, "document.querySelector('#warnings').textContent.includes('only on view')")
    draw(tab, 1, ends[1])
    axis = np.array(until(tab, "!page.stale && page.motion?.axis"))
    np.testing.assert_allclose(axis, direction / np.linalg.norm(direction), atol=0.05)
    saved(tab)
    assert [s.orientation for s in load(server.folder / "sketches" / "hand.json")] == [{"kind": "along"}] * 2
    tab.evaluate("document.activeElement.blur()")
    tab.keyboard.press("g")
    assert tab.input_value("#hand") == "free"
    until(tab, "!page.stale && page.motion && !page.motion.axis")
    tab.keyboard.press("Control+z")
    assert tab.input_value("#hand") == "along"
    draw(tab, 1, ends[1][::-1])
    until(tab, "document.querySelector('#warnings').textContent.includes('opposite sides')")
    assert len(server.strokes("hand")) == 4  # an arrow takes the place of the one before


def test_samples_are_raw_pixels_of_the_picture_whatever_the_zoom_and_the_screen(visit, server):
    tab = visit("raw", device_scale_factor=2)
    draw(tab, 0, LINE)
    tab.evaluate("page.views[0].zoomBy(3, [270, 290])")
    inside = LINE[8:14]
    draw(tab, 0, inside)
    saved(tab)
    first, second = server.strokes("raw")
    assert np.abs(first.points[[0, -1]] - LINE[[0, -1]]).max() < 0.6  # the mouse moves by whole pixels of the screen
    assert np.abs(second.points[[0, -1]] - inside[[0, -1]]).max() < 0.3
    assert first.pointer == "mouse" and len(first.points) >= 25 and (np.diff(first.times) >= 0).all() and first.duration > 0
    assert (first.demonstration, second.demonstration) == (0, 1)


def test_what_is_under_the_pointer_is_that_pixel_of_the_picture_whatever_the_zoom(visit):
    tab = visit("under")
    right = int(tab.locator(".frame").nth(1).bounding_box()["x"])
    for zoom in (1, 4):
        tab.evaluate(f"page.views[0].zoomBy({zoom}, [560, 430])")
        tab.wait_for_timeout(100)
        shot = np.array(Image.open(BytesIO(tab.screenshot())).convert("RGB"), dtype=int)[:, :right]
        (x, y), scale = places(tab, 0, [CORNER])[0], tab.evaluate("page.views[0].zoom.scale")
        red = (shot[..., 0] > 200) & (shot[..., 1:].max(axis=-1) < 60)
        rows, columns = np.nonzero(red)
        assert np.abs([columns.mean() + 0.5 - x, rows.mean() + 0.5 - y]).max() < 1.0
        assert np.sqrt(red.sum()) == pytest.approx(8 * scale, rel=0.15)


def test_undo_redo_erase_duplicate_and_clear_by_key_and_a_reload_shows_the_same(visit, server):
    tab = visit("undo")
    draw(tab, 0, LINE)
    draw(tab, 0, LINE - [0, 60])
    count = lambda: tab.evaluate("page.document.all.length")
    for key, then in (("Control+z", 1), ("Control+z", 0), ("Control+Shift+Z", 1), ("Control+y", 2), ("Shift+X", 0), ("Control+z", 2)):
        tab.keyboard.press(key)
        assert count() == then, key
    tab.keyboard.press("v")
    tab.mouse.click(*places(tab, 0, [LINE[12]])[0])
    tab.keyboard.press("Control+d")
    assert count() == 3 and tab.evaluate("page.selected.stroke.demonstration") == 2
    tab.keyboard.press("Delete")
    tab.keyboard.press("e")
    tab.mouse.click(*places(tab, 0, [LINE[12]])[0])
    assert count() == 1
    tab.keyboard.press("Control+z")
    saved(tab)
    before = tab.evaluate("page.document.text()")
    tab.reload()
    tab.wait_for_selector("body[data-ready]")
    assert tab.evaluate("page.document.text()") == before and count() == 2


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


def test_fingers_and_pens_draw_and_palms_and_second_fingers_do_not(visit, server):
    tab = visit("touch", has_touch=True)
    cdp = tab.context.new_cdp_session(tab)
    finger = lambda kind, *points: cdp.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y, "id": i} for i, x, y in points]})
    way, other = places(tab, 0, LINE), places(tab, 0, LINE + [0, 90])
    finger("touchStart", (1, *way[0]))
    for k in range(1, 25):
        if k == 15:
            finger("touchStart", (1, *way[k - 1]), (2, *other[k]))
        finger("touchMove", (1, *way[k]), *([(2, *other[k])] if k >= 15 else []))
    finger("touchEnd")
    pen = lambda kind, x, y, force=0.4: cdp.send("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, "button": "left", "buttons": 1, "clickCount": 1, "pointerType": "pen", "force": force})
    pen("mousePressed", *other[0])
    finger("touchStart", (3, *way[3]))  # the palm
    finger("touchMove", (3, *way[9]))
    for k in range(1, 25):
        pen("mouseMoved", *other[k], 0.2 + 0.02 * k)
    pen("mouseReleased", *other[-1])
    finger("touchEnd")
    saved(tab)
    strokes = server.strokes("touch")
    assert [stroke.pointer for stroke in strokes] == ["touch", "pen"]
    assert np.abs(strokes[0].points[-1] - LINE[-1]).max() < 1.5 and np.abs(strokes[1].points[-1] - LINE[-1] - [0, 90]).max() < 1.5
    assert np.ptp(strokes[1].pressure) > 0.3


def test_two_fingers_zoom_with_every_tool_and_never_move_the_picture_or_leave_a_stroke(visit, server):
    tab = visit("pinch", has_touch=True)
    cdp = tab.context.new_cdp_session(tab)
    finger = lambda kind, *points: cdp.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]})
    draw(tab, 0, LINE)
    saved(tab)
    before = tab.evaluate("page.document.text()")
    under = np.array([[280.0, 220.0], [340.0, 260.0]])  # of the picture, where the fingers are put down
    for tool in "dwkpmveh":
        tab.keyboard.press("0")
        tab.keyboard.press(tool)
        one, two = map(np.array, places(tab, 0, under))
        finger("touchStart", one)
        finger("touchStart", one, two)
        for share in np.linspace(0, 1, 6):
            finger("touchMove", one - [90 * share, 60 * share], two + [90 * share, 60 * share])
        at = np.array(places(tab, 0, under))
        np.testing.assert_allclose(at, [one - [90, 60], two + [90, 60]], atol=3)  # what was under the fingers still is
        finger("touchEnd", two + [90, 60])
        finger("touchMove", two)
        finger("touchStart", two, one)
        finger("touchMove", two + 9, one + 9)
        finger("touchEnd")
        assert tab.evaluate("!page.views[0].pen.line && !page.views[0].pen.waypoints.length && !page.selected && page.views[0].zoom.scale > 2 * page.views[0].least"), tool
    assert tab.evaluate("page.document.text()") == before
    tab.keyboard.press("d")
    way = places(tab, 0, LINE[10:16])
    finger("touchStart", way[0])
    for place in way[1:]:
        finger("touchMove", place)
    finger("touchEnd")
    saved(tab)
    first, second = server.strokes("pinch")
    assert second.pointer == "touch" and np.abs(second.points[[0, -1]] - LINE[[10, 15]]).max() < 0.6


def test_marks_and_keep_out_regions_are_drawn_and_kept(visit, server):
    tab = visit("marks")
    draw(tab, 0, LINE)
    tab.keyboard.press("m")
    tab.mouse.click(*places(tab, 0, [LINE[12]])[0])
    tab.click("#marks >> text=Close gripper")
    tab.keyboard.press("k")
    angle = np.linspace(0, 6, 20)
    draw(tab, 1, np.column_stack([300 + 80 * np.cos(angle), 200 + 60 * np.sin(angle)]))
    saved(tab)
    stroke, outline = server.strokes("marks")
    assert [event.name for event in stroke.events] == ["gripper_close"] and outline.kind == "keep_out"
    at = stroke.points[np.searchsorted(stroke.times, stroke.events[0].time).clip(0, len(stroke.points) - 1)]
    assert np.linalg.norm(at - LINE[12]) < 20


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
        tab.wait_for_timeout(400)
        assert json.loads(tab.evaluate("page.document.text()")) == json.loads(before), ending
    (tmp_path / "bad.json").write_text('{"schema": "x"}')
    tab.set_input_files("#file", tmp_path / "bad.json")
    tab.wait_for_timeout(200)
    assert "cannot be imported" in tab.inner_text("#says") and tab.evaluate("page.document.all.length") == 2


def test_of_two_pages_on_one_skill_the_second_writer_is_told_and_nothing_is_lost(visit, server):
    one = visit("shared")
    two = visit("shared", context=one.context)
    one.bring_to_front()
    draw(one, 0, LINE)
    saved(one)
    two.bring_to_front()
    two.wait_for_timeout(300)
    assert two.evaluate("page.document.all.length") == 1  # it follows as long as it has nothing of its own
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


def test_where_views_contradict_each_other_is_said_and_help_follows_the_pen(visit):
    tab = visit("apart")
    draw(tab, 0, motion(0))
    bent = np.array(motion(1))
    bent[12:20, 1] -= 70
    first, *rest = places(tab, 1, bent)
    tab.mouse.move(*first)
    tab.mouse.down()
    for place in rest:
        tab.mouse.move(*place)
    assert tab.evaluate("!!page.views[1].pen.helper && page.views[1].pen.helper.s > 0")
    tab.mouse.up()
    (found,) = tab.evaluate("page.views[1].disagreements().map(d => ({...d.part, other: d.other}))")
    assert found["other"] == "left" and found["most"] > 15 and 0.2 < found["from"] < found["to"] < 0.9


def test_the_least_certain_part_is_offered_to_be_drawn_again_close_up_on_the_view_that_sees_it_best(visit):
    tab = visit("again")
    tab.evaluate("""page.work.changed = () => {}, page.motion = {times: [0, 0.25, 0.5, 0.75, 1], duration: 2, sentence: 's', warnings: [], regions: [],
        weakest: {from: 0.25, to: 0.5, uncertainty_mm: 30, view: 'above'}, ways: [{share: 1, samples: [], covariance: Array(5).fill(Array(9).fill(0)),
        mean: [0, 1, 2, 3, 4].map(i => [0, 0.1 * i - 0.2, 0.1])}]}, page.stale = false, page.work.redrawOffered(), page.paint()""")
    tab.click("#redraw button")
    until(tab, "page.focused.zoom.scale > 1.5 * page.focused.least")
    assert tab.evaluate("page.focused.name") == "above"
    assert "once more on above" in tab.inner_text("#says")
