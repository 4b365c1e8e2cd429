"""The page on a small scene, as a process that a test may kill: serve.py FOLDER PORT [learn]."""

import sys
from functools import partial
from pathlib import Path

import numpy as np
import uvicorn
from PIL import Image, ImageDraw

from scene.camera import Camera, look_at
from teach.page.scene import Picture, Scene
from teach.page.server import Page, create
from teach.page.solid import Solid
from teach.page.store import Store
from teach.page.worker import Worker

VIEWS = {
    name: Camera.from_fov(look_at(eye, [0, 0, 0.1]), 640, 480, 50)
    for name, eye in {"left": [1.0, 0.7, 0.8], "right": [0.9, -0.8, 0.9], "above": [0.4, 0.0, 1.5]}.items()
}

CORNER = (600, 460)
"""A red place [px] near a corner of each picture."""


def learning() -> dict:
    from teach.density import Kernels
    from teach.page.learned import learn
    from teach.rptl import fit

    return {"fit": partial(learn, partial(fit, density=Kernels()))}


def acting() -> dict:
    return {"render": render, "suggest": suggest, "plan": plan, "perform": perform, "body": body}


def render(progress, camera):
    return np.broadcast_to(np.linspace(60, 200, camera.width, dtype=np.uint8)[None, :, None], (camera.height, camera.width, 3)).copy()


def suggest(progress, sketches):
    """From behind what is drawn first."""
    like = sketches[0].camera
    return Camera.from_fov(look_at([-0.9, 0.3, 1.0], [0, 0, 0.1]), like.width, like.height, 50), "a view from behind: expected 9 mm instead of 300 mm without it"


def body(progress):
    """An arm of one box."""
    corners = [[x, y, z] for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (-0.03, 0.03)]
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return {"name": "box", "links": [{"name": "hand", "vertices": corners, "faces": faces}], "home": [[0, -0.3, 0.1, 0, 0, 0, 1]]}


def surface() -> Solid:
    vertices = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    return Solid(vertices, np.array([[0, 2, 3], [0, 3, 1]]), np.full((4, 3), 170, np.uint8))


def plan(progress, skill, keep):
    """As if the arm touched something in the middle."""
    progress(0.5, "Looking")
    keep.write_bytes(b"")
    tip = np.linspace([0, -0.2, 0.1], [0, 0.2, 0.1], 30)
    touches = [10 < i < 20 for i in range(30)]
    return {"feasible": False, "sentence": "the mean: finger touches cup at 40 %", "refusals": [], "times": list(np.linspace(0, 3, 30)), "tip": tip.tolist(),
            "events": [{"name": "gripper_close", "time": 1.5}], "clearance_mm": [20.0] * 30, "touches": touches, "strays": [False] * 30, "least_mm": -3.0, "duration": 3.0,
            "links": [[[*p, 0, 0, 0, 1]] for p in tip.tolist()]}  # fmt: skip


def perform(progress, plan, skill, keep):
    raise ValueError("nothing here performs")


def scene(folder: Path) -> Scene:
    for name, camera in VIEWS.items():
        image = Image.new("RGB", (camera.width, camera.height), (196, 186, 170))
        draw = ImageDraw.Draw(image)
        grid = np.linspace(-0.5, 0.5, 11)
        for x in grid:
            for line in (np.array([[x, -0.5, 0], [x, 0.5, 0]]), np.array([[-0.5, x, 0], [0.5, x, 0]])):
                draw.line([tuple(p) for p in camera.project(line)], fill=(150, 138, 120), width=1)
        draw.rectangle([*(np.array(CORNER) - 4), *(np.array(CORNER) + 3)], fill=(255, 0, 0))
        image.save(folder / f"{name}.png")
    points = np.random.default_rng(0).uniform([-0.5, -0.5, 0], [0.5, 0.5, 0.01], (400, 3))
    views = {name: Picture(folder / f"{name}.png", camera, "rendered") for name, camera in VIEWS.items()}
    return Scene("grid", views, points, np.full((400, 3), 150, np.uint8), target=(0.0, 0.0, 0.1), mesh=surface)


def main(folder: str, port: str, learns: str = "") -> None:
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    works = {}
    if learns:
        actor = Worker(acting)
        works = {"fit": Worker(learning), "render": actor, "suggest": actor, "plan": actor, "perform": actor, "body": actor}
    page = Page(Store(folder / "sketches"), scene(folder), works, finished=lambda name, sketches: (folder / "done").write_text(name))
    uvicorn.run(create(page), host="127.0.0.1", port=int(port), log_level="warning", loop="asyncio")


if __name__ == "__main__":
    main(*sys.argv[1:])
