"""How fast the sketching page is: python tests/benchmarks/page.py CAPTURE [--pictures docs]

CAPTURE is a capture folder with field.pt and views (data/table); it is served from a copy of its links. Prints a table of
what the page promises. --pictures also writes page.png and page.gif of a person's way through it.
"""

import argparse
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
from playwright.sync_api import sync_playwright

from scene.dataset import load_views
from teach import scripted
from teach.hand import Hand

ROOT = Path(__file__).parents[2]
ARGUMENTS = ["--no-sandbox", "--disable-background-networking"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--repeat", type=int, default=5)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        capture = linked(asked.capture.resolve(), Path(folder) / "table")
        server, address = serve(capture, Path(folder))
        try:
            browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=ARGUMENTS)
            strokes = hand_drawn(capture)
            wait_warm(browser, address, strokes)
            if asked.pictures:
                pictures(browser, address, strokes, asked.pictures)
            else:
                measured = (lambda: loading(browser, address, asked.repeat), lambda: inking(browser, address),
                            lambda: learning(browser, address, strokes, asked.repeat), lambda: orbiting(browser, address, asked.repeat))  # fmt: skip
                for measure in measured:
                    for row in measure():
                        print("{:58} {:>12}   floor {}".format(*row), flush=True)
            browser.close()
        finally:
            os.killpg(server.pid, signal.SIGKILL)


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
        page.wait_for_timeout(300)
        sizes.append(sum(len(r.body()) for r in sent if "/pictures/" not in r.url))
        page.context.close()
    return [("page load on localhost, median", f"{statistics.median(times):.2f} s", "1 s"), ("sent without pictures", f"{max(sizes) / 1024:.0f} kB", "1024 kB")]


INK = """async () => {
  // 240 samples a second for three seconds, in events of Chromium's own kind, beside 30 strokes of 2000 points
  const view = page.views[0], sketch = {view: view.name, camera: view.view.camera, strokes: []}
  const line = k => Array.from({length: 2000}, (_, i) => [20 + 0.3 * i, 200 + 4 * k + 60 * Math.sin(i / 300 + k)])
  for (let k = 0; k < 30; k++) sketch.strokes.push({points: line(k), times: line(k).map((_, i) => i / 240), demonstration: k, kind: 'motion'})
  page.document.change('30 strokes', () => [sketch])
  await page.saver.running
  await new Promise(done => setTimeout(done, 500))
  const {left, top} = view.frame.getBoundingClientRect(), late = [], spent = []
  let sent = 0, frame = performance.now()
  const event = (type, x, y, list = []) => { const e = new PointerEvent(type, {pointerId: 1, pointerType: 'pen', isPrimary: true, clientX: left + x, clientY: top + y, pressure: 0.5, bubbles: true, buttons: 1, coalescedEvents: list}); return e }
  view.frame.setPointerCapture = () => {}
  view.frame.dispatchEvent(event('pointerdown', 50, 200)); sent++
  const began = performance.now()
  await new Promise(done => {
    const step = now => {
      late.push(now - frame); frame = now
      const due = Math.min(720, Math.floor((performance.now() - began) * 0.24)), list = []
      while (sent <= due) { list.push(event('pointermove', 50 + sent * 0.6, 200 + 50 * Math.sin(sent / 40))); sent++ }
      const t = performance.now()
      if (list.length) view.frame.dispatchEvent(event('pointermove', 50 + sent * 0.6, 200, list))
      spent.push(performance.now() - t)
      if (sent <= 720) requestAnimationFrame(step); else done()
    }
    requestAnimationFrame(step)
  })
  const kept = view.pen.line.points.length, painted = view.pen.painted
  view.frame.dispatchEvent(event('pointerup', 50 + sent * 0.6, 200))
  return {sent, kept, painted, spent: spent.sort((a, b) => a - b), frames: late.slice(1).sort((a, b) => a - b)}
}"""


def inking(browser, address):
    page = opened(browser, address, "ink")
    found = page.evaluate(INK)
    page.context.close()
    at = lambda values, share: values[int(share * (len(values) - 1))]
    return [
        ("samples at 240 Hz beside 30 strokes of 2,000 points: lost", f"{found['sent'] - found['kept']} of {found['sent']}", "0"),
        ("samples of an event not yet painted when it returns", f"{found['kept'] - found['painted']}", "0"),
        ("time in the pointer event, median / 99 %", f"{at(found['spent'], 0.5):.1f} / {at(found['spent'], 0.99):.1f} ms", "16.7 ms"),
        ("time from frame to frame meanwhile, median / 95 %", f"{at(found['frames'], 0.5):.0f} / {at(found['frames'], 0.95):.0f} ms", "17 ms"),
    ]


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
    return [("orbit, coarse 160x120, median", f"{statistics.median(coarse) / 1000:.2f} s", "0.25 s"), ("orbit, sharp 640x480, median", f"{statistics.median(sharp) / 1000:.2f} s", "1 s")]


def pictures(browser, address, strokes, folder: Path) -> None:
    """page.gif: drawing on both pictures, the motion, its way through time, the check. page.png: what one sees then."""
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
    for t in np.linspace(0, 1, 12):
        page.evaluate(f"page.setTime({t})")
        page.wait_for_timeout(60)
        shot(110)
    page.evaluate("page.setTime(0.55)")
    page.keyboard.press("Control+Enter")
    page.wait_for_selector("#verdict:not([hidden])", timeout=240000)
    page.wait_for_timeout(200)
    shot(2500)
    folder.mkdir(exist_ok=True)
    frames[-1][0].quantize(256, dither=Image.Dither.NONE).save(folder / "page.png", optimize=True)
    small = [frame.resize((800, 500), Image.Resampling.LANCZOS) for frame, _ in frames]
    palette = small[-1].quantize(128)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in small]
    small[0].save(folder / "page.gif", save_all=True, append_images=small[1:], duration=[d for _, d in frames], loop=0, optimize=True)
    for name in ("page.png", "page.gif"):
        print(folder / name, f"{(folder / name).stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
