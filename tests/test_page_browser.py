"""A person's two minutes, in a real browser: every pointer event is Chromium's own."""

import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scene.camera import Camera
from teach.sketch import load

sys.path.insert(0, str(Path(__file__).parent / "page"))
pytest.register_assert_rewrite("browsing")
from browsing import LINE, draw, motion, needs_chromium, places, saved, until  # noqa: E402
from serve import CORNER, VIEWS  # noqa: E402

pytest_plugins = ["browsing"]
pytestmark = needs_chromium

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
    meant = np.hstack([0.1 * np.sin(3 * FINE), 0.5 * FINE - 0.25, 0.05 + 0.3 * FINE])
    off = np.linalg.norm(learned[:, None] - meant, axis=2).min(axis=1)  # whatever the speed at which a busy machine moved the mouse
    assert np.median(off) < 0.01 and off.max() < 0.02, off.max()  # a single stroke a view
    np.testing.assert_allclose(learned[[0, -1], 1], [-0.25, 0.25], atol=0.02)
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


GHOST = """() => {
  const {raster: {width, pixels}} = page.views[0].ghost, sum = [0, 0, 0]
  pixels.forEach((c, i) => { if (c) { sum[0] += i % width + 0.5; sum[1] += Math.floor(i / width) + 0.5; sum[2]++ } })
  return [sum[0] / sum[2], sum[1] / sum[2]]
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
    box = np.array(tab.evaluate(GHOST))  # the same on a picture, as its camera sees it
    np.testing.assert_allclose(box, list(VIEWS.values())[0].project(np.array([0, 0.2, 0.1])), atol=4)
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
        spread = np.array([one - [90, 60], two + [90, 60]])
        until(tab, lambda: np.abs(np.array(places(tab, 0, under)) - spread).max() < 3)  # what was under the fingers still is
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
    assert f"on right: up to {found['most']:.0f} px from where left puts it" in tab.inner_text("#apart")


def test_a_part_that_was_drawn_badly_is_offered_and_drawn_anew_in_its_stroke(visit, server):
    tab = visit("again")
    bent = np.array(motion(1))
    bent[13:20, 1] -= 80 * np.sin(np.linspace(0.4, 2.7, 7))
    draw(tab, 0, motion(0))
    draw(tab, 1, bent)
    weak = until(tab, "!page.stale && page.motion?.weakest")
    assert weak["clear"] and 0.2 < weak["from"] < weak["to"] < 0.9 and tab.is_visible("#weak")
    assert "of it: draw that part once more" in tab.inner_text("#sentence")
    tab.click("#redraw button")
    until(tab, "page.focused.zoom.scale > 1.5 * page.focused.least")
    view = tab.evaluate("page.views.indexOf(page.redraw.view)")
    assert tab.evaluate("page.focused.number") == view and "begin and end on a stroke" in tab.inner_text("#says")
    tab.keyboard.press("-")
    drawn, k = server.strokes("again")[view], slice(12, 22)
    along = np.linalg.norm(drawn.points - motion(view)[12], axis=1).argmin(), np.linalg.norm(drawn.points - motion(view)[21], axis=1).argmin()
    draw(tab, view, motion(view)[k])
    assert "drawn anew" in tab.inner_text("#says") and tab.evaluate("page.redraw.view") is None
    saved(tab)
    mended = server.strokes("again")[view]
    assert len(server.strokes("again")) == 2 and (np.diff(mended.times) >= 0).all()
    assert (mended.points[: along[0] - 1] == drawn.points[: along[0] - 1]).all()  # what was not drawn anew is as it was
    n = len(drawn.points) - along[1] - 2
    assert (mended.points[-n:] == drawn.points[-n:]).all()
    off = np.linalg.norm(motion(view)[k][:, None] - mended.points, axis=2).min(axis=1)
    assert off.max() < 3
    tab.keyboard.press("Control+z")
    saved(tab)
    assert (server.strokes("again")[view].points == drawn.points).all()


def test_a_viewpoint_is_suggested_with_why_and_taken_beside_what_is_drawn(visit, server):
    tab = visit("suggested")
    assert "from beginning to end" in tab.inner_text(".frame .hint >> nth=0")
    assert not tab.is_visible("#suggest")
    draw(tab, 0, motion(0))
    saved(tab)
    tab.click("#suggest button")
    until(tab, "document.querySelector('#orbit-words').textContent.includes('9 mm instead of 300 mm')")
    tab.wait_for_selector("#orbit-picture[data-width='640']")
    tab.click("#orbit-use")
    until(tab, "page.views[1].name === 'viewpoint 1' && !!page.views[1].image")
    assert tab.evaluate("page.views[0].name") == "left"
    assert tab.inner_text(".frame .hint >> nth=1") == "Now the same motion here"
    camera = tab.evaluate("page.views[1].view.camera")
    np.testing.assert_allclose(np.array(camera["world_from_camera"])[:3, 3], [-0.9, 0.3, 1.0], atol=1e-6)
    t = np.linspace(0, 1, 30)[:, None]
    curve = np.hstack([0.1 * np.sin(3 * t), 0.5 * t - 0.25, 0.05 + 0.3 * t])
    draw(tab, 1, Camera(camera["K"], camera["world_from_camera"], 640, 480).project(curve))
    assert tab.inner_text(".frame .hint >> nth=1") == ""
    tab.wait_for_selector("body[data-motion=shown]", timeout=60000)
    tab.click("#act >> text=Check")
    tab.wait_for_selector("#verdict:not([hidden])")
    tick = tab.locator("#ticks span")  # the gripper closes in the middle of the checked motion
    assert tick.inner_text() == "C" and "50%" in tick.get_attribute("style")


def test_what_a_click_would_do_is_shown_before_it_is_done(visit):
    tab = visit("hover")
    draw(tab, 0, motion(0))
    at = lambda view, k: places(tab, view, [motion(view)[k]])[0]
    tab.mouse.move(*at(1, 20))  # where the second stroke begins: on the first pixel's epipolar line
    assert tab.evaluate("page.views[1].pen.over")
    lit = "(() => { const c = page.views[%d].layers.help; return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(x => x) })()"
    until(tab, lit % 1)
    tab.keyboard.press("v")
    tab.mouse.move(*at(0, 12))
    until(tab, "!!page.views[0].choice.hovered")
    assert tab.evaluate("getComputedStyle(page.views[0].frame).cursor") == "pointer"
    tab.mouse.move(*places(tab, 0, [motion(0)[12] + [0, 120]])[0])
    until(tab, "!page.views[0].choice.hovered")
    assert tab.evaluate("getComputedStyle(page.views[0].frame).cursor") == "default"


def test_another_viewpoint_is_seen_coarsely_then_sharply_and_can_be_drawn_on(visit, server):
    tab = visit("orbit")
    tab.evaluate("""() => {
      const shown = globalThis.shown = []
      new MutationObserver(() => shown.push(+page.orbit.image.dataset.width)).observe(page.orbit.image, {attributeFilter: ['data-width']})
    }""")
    tab.keyboard.press("a")
    tab.wait_for_selector("#orbit-picture[data-width='640']")
    for _ in range(3):
        tab.keyboard.press("ArrowRight")
    until(tab, "shown.length > 3 && shown.at(-1) === 640")
    shown = tab.evaluate("shown")
    assert shown[0] == 160 and shown[shown.index(640) + 1] == 160  # never sharp before it was coarse
    tab.click("#orbit-use")
    until(tab, "!document.querySelector('#orbit').open && page.views[0].name === 'viewpoint 1' && !!page.views[0].image")
    draw(tab, 0, LINE)
    saved(tab)
    (sketch,) = load(server.folder / "sketches" / "orbit.json")
    first = list(VIEWS.values())[0]
    assert sketch.view == "viewpoint 1" and 0.2 < np.linalg.norm(sketch.camera.centre - first.centre) < 0.6
