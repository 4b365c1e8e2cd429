"""What tests of the page share: a server that they may kill, a browser, drawing with real pointer events."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from serve import VIEWS

from teach.sketch import load

ROOT = Path(__file__).parents[2]
CHROMIUM = "/usr/bin/chromium"
LINE = np.column_stack([np.linspace(150, 480, 25), 260 + 60 * np.sin(np.linspace(0, 4, 25))])
"""Pixels of a stroke."""
needs_chromium = pytest.mark.skipif(not Path(CHROMIUM).exists(), reason="no Chromium on this machine")


class Server:
    """tests/page/serve.py as a process; starts again on the same port after kill()."""

    def __init__(self, folder: Path, learn: bool = False):
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.folder, self.learn = folder, learn
        self.start()

    def start(self):
        command = [sys.executable, ROOT / "tests" / "page" / "serve.py", self.folder, str(self.port), *(["learn"] * self.learn)]
        environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(command, env=environment)
        for _ in range(600):
            try:
                return urllib.request.urlopen(f"{self.address}/api/skills", timeout=2).read()
            except OSError:
                time.sleep(0.05)
        raise RuntimeError("the server does not answer")

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def strokes(self, skill: str) -> list:
        return [stroke for sketch in load(self.folder / "sketches" / f"{skill}.json") for stroke in sketch.strokes]


@pytest.fixture(scope="module")
def browser():
    """Ended after each file: while it runs, no test of this process can run an event loop of its own."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-background-networking"])
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("page"), learn=True)
    yield server
    server.kill()


@pytest.fixture
def visit(browser, server):
    """visit(skill, ...) opens a tab; a script error in any of them fails the test."""
    contexts, errors = [], []

    def open_tab(skill, at=server, context=None, **settings):
        if context is None:
            context = browser.new_context(viewport={"width": 1280, "height": 800}, **settings)
            contexts.append(context)
        tab = context.new_page()
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.goto(f"{at.address}/?skill={skill}")
        tab.wait_for_selector("body[data-ready]")
        return tab

    yield open_tab
    for context in contexts:
        context.close()
    assert not errors


def places(tab, view: int, pixels) -> list[tuple[float, float]]:
    """Pixels of a picture -> positions in the window."""
    box, zoom = tab.locator(".frame").nth(view).bounding_box(), tab.evaluate(f"page.views[{view}].zoom")
    return [(box["x"] + zoom["x"] + zoom["scale"] * u, box["y"] + zoom["y"] + zoom["scale"] * v) for u, v in pixels]


def draw(tab, view: int, pixels) -> None:
    """With the mouse."""
    first, *rest = places(tab, view, pixels)
    tab.mouse.move(*first)
    tab.mouse.down()
    for place in rest:
        tab.mouse.move(*place)
    tab.mouse.up()


def saved(tab) -> None:
    tab.wait_for_timeout(30)
    tab.wait_for_selector("#saving[data-state=saved]", timeout=20000)


def until(tab, words, seconds: float = 20):
    """The value of an expression of the page, or of a function here, once it is true: the page's policy lets no function be
    waited for."""
    for _ in range(int(20 * seconds)):
        if value := words() if callable(words) else tab.evaluate(words):
            return value
        tab.wait_for_timeout(50)
    raise AssertionError(f"never true: {words}")


def motion(view: int, shift=0.0) -> np.ndarray:
    t = np.linspace(0, 1, 30)[:, None]
    curve = np.hstack([0.1 * np.sin(3 * t), 0.5 * t - 0.25, 0.05 + 0.3 * t])  # it rises: no stroke runs along the other view's epipolar lines
    return list(VIEWS.values())[view].project(curve) + shift
