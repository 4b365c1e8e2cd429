"""How fast the sketching page is: python tests/benchmarks/page.py CAPTURE [--pictures docs]

CAPTURE is a capture folder with field.pt, views and mesh.ply (data/table after scene.mesh); it is served from a copy of its links. Prints a table of
what the page promises. --pictures also writes page.png and page.gif of a person's way through it.
"""

import argparse
import asyncio
import base64
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from io import BytesIO
from pathlib import Path

import numpy as np
import yaml
from PIL import Image
from playwright.async_api import async_playwright
from playwright.sync_api import sync_playwright

from scene.dataset import load_views
from teach import scripted
from teach.hand import Hand
from teach.sketch import load

ROOT = Path(__file__).parents[2]
ARGUMENTS = ["--no-sandbox", "--disable-background-networking"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--repeat", type=int, default=5)
    asked = parser.parse_args()
    if not (asked.capture / "mesh.ply").exists():
        parser.error(f"{asked.capture} has no mesh.ply to show in space: run python -m scene.mesh first")
    with tempfile.TemporaryDirectory() as folder:
        capture = linked(asked.capture.resolve(), Path(folder) / "table")
        server, address = serve(capture, Path(folder))
        try:
            with sync_playwright() as playwright:
                by_playwright(playwright, address, capture, asked)
            if not asked.pictures:
                asyncio.run(by_real_input(address, capture / "sketches"))
        finally:
            os.killpg(server.pid, signal.SIGKILL)


def by_playwright(playwright, address, capture, asked) -> None:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=ARGUMENTS)
    strokes = hand_drawn(capture)
    wait_warm(browser, address, strokes)
    if asked.pictures:
        return pictures(browser, address, strokes, asked.pictures)
    for part in (
        lambda: orbiting(browser, address, asked.repeat),
        lambda: loading(browser, address, asked.repeat),
        lambda: learning(browser, address, strokes, asked.repeat),
        lambda: in_space(browser, address),
    ):
        began = time.perf_counter()
        show(part(), began)
    browser.close()


def show(rows, began: float) -> None:
    """Print rows as they come. began [s]: when their measuring did."""
    for row in rows:
        print("{:82} {:>22}   floor {}".format(*row), flush=True)
    load, took = os.getloadavg()[0], time.perf_counter() - began
    print(f"  in {took:.0f} s, load of this machine: {load:.1f} on {os.cpu_count()} cores", flush=True)


def linked(capture: Path, copy: Path) -> Path:
    """The capture without its sketches, without altering it."""
    copy.mkdir()
    for path in capture.iterdir():
        if path.name not in ("sketches", ".stages"):
            (copy / path.name).symlink_to(path)
    (copy / ".stages").mkdir()
    for path in (capture / ".stages").glob("*.json"):
        (copy / ".stages" / path.name).write_bytes(path.read_bytes())
    return copy


def serve(capture: Path, folder: Path):
    command = [sys.executable, "-m", "teach.draw", f"data={capture}", "user.port=0", f"hydra.run.dir={folder}/run"]
    log = folder / "log"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    server = subprocess.Popen(command, cwd=folder, stdout=log.open("w"), stderr=subprocess.STDOUT, env=environment, start_new_session=True)
    for _ in range(600):
        if found := re.search(r"draw at (http://\S+?)/\s", log.read_text()):
            return server, found[1]
        time.sleep(0.1)
    raise RuntimeError(log.read_text())


def hand_drawn(capture: Path) -> dict[str, list]:
    """Three strokes of a scripted hand on each of the two views."""
    via = np.array(yaml.safe_load((ROOT / "conf/world/table.yaml").read_text())["motion"]["via"], dtype=float)
    rng, views = np.random.default_rng(0), load_views(capture / "views")[:2]
    sketches = [scripted.sketch(view.name, view.camera, via, Hand(), rng, count=3)[0] for view in views]
    return [[stroke.at(np.linspace(0, 1, 60)) for stroke in sketch.motions] for sketch in sketches]


def opened(browser, address, skill, **settings):
    page = browser.new_context(**({"viewport": {"width": 1280, "height": 800}} | settings)).new_page()
    page.goto(f"{address}/?skill={skill}")
    page.wait_for_selector("body[data-ready]", timeout=60000)
    return page


def draw(page, view: int, pixels, each=lambda k: None, pause: float = 0.0) -> None:
    box, zoom = page.locator(".frame").nth(view).bounding_box(), page.evaluate(f"page.views[{view}].zoom")
    places = [(box["x"] + zoom["x"] + zoom["scale"] * u, box["y"] + zoom["y"] + zoom["scale"] * v) for u, v in pixels]
    page.mouse.move(*places[0])
    page.mouse.down()
    for k, place in enumerate(places[1:]):
        page.mouse.move(*place)
        time.sleep(pause)
        each(k)
    page.mouse.up()


def wait_warm(browser, address, strokes) -> None:
    page = opened(browser, address, "warm")
    for view in range(2):
        draw(page, view, strokes[view][0])
    page.wait_for_selector("body[data-motion=shown]", timeout=120000)
    page.keyboard.press("a")
    page.wait_for_selector("#orbit-picture[data-width='640']", timeout=120000)
    page.context.close()


def loading(browser, address, repeat):
    """Until the pictures can be drawn on, and what was sent."""
    times, sizes = [], []
    for _ in range(repeat):
        page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
        sent = []
        page.on("response", lambda r: sent.append(r))
        started = time.perf_counter()
        page.goto(f"{address}/?skill=load")
        page.wait_for_selector("body[data-ready]")
        times.append(time.perf_counter() - started)
        while not page.evaluate("!!(page.space.mesh && page.space.arm)"):
            page.wait_for_timeout(50)
        sizes.append(sum(len(r.body()) for r in sent if "/pictures/" not in r.url))
        page.context.close()
    return [("page load on localhost, median", f"{statistics.median(times):.2f} s", "1 s"), ("sent without pictures, the surface and the arm in space among it, unpacked", f"{max(sizes) / 1024:.0f} kB", "1024 kB")]


STROKES = """() => {
  const view = page.views[0], sketch = {view: view.name, camera: view.view.camera, strokes: []}
  const line = k => Array.from({length: 2000}, (_, i) => [20 + 0.3 * i, 200 + 4 * k + 60 * Math.sin(i / 300 + k)])
  for (let k = 0; k < 30; k++) sketch.strokes.push({points: line(k), times: line(k).map((_, i) => i / 240), demonstration: k, kind: 'motion'})
  page.document.change('30 strokes', () => [sketch])
}"""
WATCH = """() => {
  // when each sample was painted after it was made, and the time from frame to frame meanwhile
  const {pen} = page.views[0], move = pen.move.bind(pen), seen = globalThis.seen = {late: [], spent: [], frames: [], unpainted: 0, samples: 0}
  pen.move = event => {
    const began = performance.now()
    move(event)
    const made = event.getCoalescedEvents().map(e => e.timeStamp)
    for (const time of made) seen.late.push(performance.now() - time)
    seen.spent.push(performance.now() - began)
    seen.samples = pen.line?.points.length ?? seen.samples
    seen.unpainted += (pen.line?.points.length ?? 0) - pen.painted
  }
  let before = performance.now()
  const frame = now => { if (pen.line) seen.frames.push(now - before); before = now; requestAnimationFrame(frame) }
  requestAnimationFrame(frame)
}"""
RATE, SECONDS = 240, 3


async def stroke(page, view: int, pixels, rate: float = RATE) -> int:
    """One line by events of the browser's own input, as many a second as asked for, whether they were dealt with or not;
    how many were sent between press and release."""
    box, zoom = await page.locator(".frame").nth(view).bounding_box(), await page.evaluate(f"page.views[{view}].zoom")
    session = await page.context.new_cdp_session(page)
    places = [(box["x"] + zoom["x"] + zoom["scale"] * u, box["y"] + zoom["y"] + zoom["scale"] * v) for u, v in pixels]

    def send(kind, place):
        told = {"type": kind, "x": place[0], "y": place[1], "button": "left", "buttons": 1, "clickCount": 1, "pointerType": "pen", "force": 0.5}
        return asyncio.ensure_future(session.send("Input.dispatchMouseEvent", told))

    await send("mousePressed", places[0])
    began, waiting = time.perf_counter(), []
    for k, place in enumerate(places[1:]):
        await asyncio.sleep(max(0.0, began + k / rate - time.perf_counter()))
        waiting.append(send("mouseMoved", place))
    await asyncio.gather(*waiting)
    await send("mouseReleased", places[-1])
    return len(waiting)


async def inking(browser, address):
    """240 samples a second for three seconds beside 30 strokes of 2,000 points."""
    page = await async_opened(browser, address, "ink")
    await page.evaluate(STROKES)
    await page.wait_for_selector("#saving[data-state=saved]", timeout=60000)
    await page.evaluate(WATCH)
    t = np.linspace(0, 1, RATE * SECONDS + 1)
    started = time.perf_counter()
    sent = await stroke(page, 0, np.column_stack([60 + 500 * t, 240 + 120 * np.sin(20 * t)]))
    took = time.perf_counter() - started
    seen = await page.evaluate("seen")
    await page.context.close()
    lost = sent + 1 - seen["samples"]
    at = lambda name, share: sorted(seen[name])[int(share * (len(seen[name]) - 1))]
    return [
        (f"real input, {sent / took:.0f} Hz beside 30 strokes of 2,000 points: lost", f"{lost} of {sent}", "0"),
        ("samples not painted when their event returns", f"{seen['unpainted']}", "0"),
        ("from a sample's time stamp to its paint, median / 95 %", f"{at('late', 0.5):.0f} / {at('late', 0.95):.0f} ms", "next frame"),
        ("time in the pointer event, median / 99 %", f"{at('spent', 0.5):.1f} / {at('spent', 0.99):.1f} ms", "16.7 ms"),
        ("time from frame to frame meanwhile, median / 95 %", f"{at('frames', 0.5):.0f} / {at('frames', 0.95):.0f} ms", "17 ms"),
    ]


async def many_tabs(browser, address, folder: Path, count: int = 20):
    """As many tabs as asked for draw at once, each its own skill: two strokes of its own height."""
    t = np.linspace(0, 1, 90)
    pages = [await async_opened(browser, address, f"tab{k}") for k in range(count)]
    lines = [np.column_stack([100 + 400 * t, 30 + 20 * k + 8 * np.sin(9 * t)]) for k in range(count)]

    async def draw_both(k):
        for view in range(2):
            await stroke(pages[k], view, lines[k], rate=60)
        await pages[k].wait_for_selector("#saving[data-state=saved]", timeout=120000)

    await asyncio.gather(*(draw_both(k) for k in range(count)))
    await asyncio.sleep(1)
    mixed = lost = 0
    for k, line in enumerate(lines):
        path = folder / f"tab{k}.json"
        strokes = [stroke for sketch in load(path) for stroke in sketch.strokes] if path.exists() else []
        lost += 2 - len(strokes)
        mixed += sum(np.abs(stroke.points[:, 1] - line[:, 1].mean()).max() > 12 or len(stroke.points) < len(t) for stroke in strokes)
    for page in pages:
        await page.context.close()
    return [(f"{count} tabs draw on {count} skills at once: strokes lost / mixed or short of samples", f"{lost} / {mixed} of {2 * count}", "0")]


async def async_opened(browser, address, skill):
    page = await (await browser.new_context(viewport={"width": 1280, "height": 800})).new_page()
    await page.goto(f"{address}/?skill={skill}")
    await page.wait_for_selector("body[data-ready]", timeout=60000)
    return page


async def by_real_input(address, folder):
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path="/usr/bin/chromium", args=ARGUMENTS)
        for part in (inking(browser, address), many_tabs(browser, address, folder)):
            began = time.perf_counter()
            show(await part, began)


def learning(browser, address, strokes, repeat):
    """From the end of the last of six strokes until its motion is shown, warm."""
    times = []
    for k in range(repeat):
        page = opened(browser, address, f"learn{k}")
        for number in range(3):
            for view in range(2):
                draw(page, view, strokes[view][number])
        started = time.perf_counter()
        page.wait_for_selector("body[data-motion=shown]", timeout=60000)
        times.append(time.perf_counter() - started)
        page.context.close()
    return [("motion after the last stroke (2 views, 3 strokes), median", f"{statistics.median(times):.2f} s", "2 s")]


def orbiting(browser, address, repeat):
    page = opened(browser, address, "orbit")
    page.keyboard.press("a")
    coarse, sharp = [], []
    for _ in range(repeat):
        page.wait_for_selector("#orbit-picture[data-width='640']", timeout=60000)
        page.wait_for_timeout(200)
        page.keyboard.press("ArrowRight")
        page.wait_for_selector("#orbit-picture[data-width='160']", timeout=60000)
        coarse.append(int(page.get_attribute("#orbit-picture", "data-ms")))
        page.wait_for_selector("#orbit-picture[data-width='640']", timeout=60000)
        sharp.append(int(page.get_attribute("#orbit-picture", "data-ms")))
    page.context.close()
    told = lambda found: f"{statistics.median(found) / 1000:.2f} s ({min(found) / 1000:.2f} to {max(found) / 1000:.2f})"
    return [("orbit, coarse 160x120, median", told(coarse), "0.25 s"), ("orbit, sharp 640x480, median", told(sharp), "1 s")]


SPACE = """() => {
  const {space} = page, mean = (n, act) => { const began = performance.now(); for (let i = 0; i < n; i++) act(i); return (performance.now() - began) / n }
  const turned = mean(20, i => { space.fine = 0; space.kept = false; space.table.place.azimuth += 0.05; space.paintNow() })
  space.fine = 1
  space.paintNow()
  return [turned, mean(20, i => { page.clock.time = i / 20; space.paintNow() })]
}"""


def in_space(browser, address):
    """Time to draw the surface and the arm in space, small and large."""
    page, rows = opened(browser, address, "warm"), []
    while not page.evaluate("!!(page.space.mesh && page.space.arm)"):
        page.wait_for_timeout(100)
    for size in ("small", "large"):
        turned, played = page.evaluate(SPACE)
        rows.append((f"in space, {size}: a frame while turning / while time passes", f"{turned:.0f} / {played:.0f} ms", "none"))
        page.evaluate("page.space.enlarge()")
        page.wait_for_timeout(500)
    page.context.close()
    return rows


def pictures(browser, address, strokes, folder: Path) -> None:
    """page.gif: drawing on both pictures, the motion, the check, the arm's way through time. page.png: what one sees then."""
    page, frames = opened(browser, address, "reach%20the%20can", device_scale_factor=1), []
    session = page.context.new_cdp_session(page)

    def shot(duration: int) -> None:
        picture = session.send("Page.captureScreenshot", {"format": "jpeg", "quality": 95})["data"]
        frames.append((Image.open(BytesIO(base64.b64decode(picture))).convert("RGB"), duration))

    shot(700)
    for number in range(3):
        for view in range(2):
            every = 9 if number == 0 else 25
            draw(page, view, strokes[view][number], lambda k: shot(90) if k % every == every - 1 else None, pause=0.012)
            shot(250)
    page.wait_for_selector("body[data-motion=shown]", timeout=60000)
    while not page.evaluate("!!(page.space.mesh && page.space.arm)"):
        page.wait_for_timeout(100)
    shot(900)
    page.keyboard.press("Control+Enter")
    page.wait_for_selector("#verdict:not([hidden])", timeout=240000)
    for t in np.linspace(0, 1, 12):
        page.evaluate(f"page.setTime({t})")
        page.wait_for_timeout(60)
        shot(130)
    page.evaluate("page.setTime(0.62)")
    page.wait_for_timeout(300)
    shot(2500)
    folder.mkdir(exist_ok=True)
    palette_of = {"method": Image.Quantize.FASTOCTREE, "dither": Image.Dither.NONE}  # the others wash the inks out
    frames[-1][0].quantize(256, **palette_of).save(folder / "page.png", optimize=True)
    small = [frame.resize((800, 500), Image.Resampling.LANCZOS) for frame, _ in frames]
    palette = small[-1].quantize(128, **palette_of)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in small]
    small[0].save(folder / "page.gif", save_all=True, append_images=small[1:], duration=[d for _, d in frames], loop=0, optimize=True)
    for name in ("page.png", "page.gif"):
        print(folder / name, f"{(folder / name).stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
