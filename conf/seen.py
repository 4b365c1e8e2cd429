"""What the scripted user sees and draws: the only place, beside evaluation, where the truth of a world is known.

On rendered views the picture itself is what a person goes by: where the field shows an object a few pixels off, the
stroke lands a few pixels off. So a stroke is displaced by the optical flow from a true picture at the same pose to the
shown one. On photographs the stroke is drawn with the true camera, while fitting knows the estimated one.
"""

import json
from dataclasses import dataclass

import numpy as np
from hydra.utils import instantiate

from conf.stages import Job
from robot.mounting import mounted
from robot.variation import varied
from scene.camera import Camera
from scene.dataset import load_views
from teach import scripted
from teach.sketch import Sketch


@dataclass(frozen=True)
class Page:
    """A picture to draw on. camera: what fitting knows; true_camera: where it was really taken; flow: (H, W, 2) [px] or None."""

    name: str
    camera: Camera
    true_camera: Camera
    flow: np.ndarray | None


def draw(job: Job, names: list[str]) -> tuple[list[Sketch], np.ndarray]:
    """One sketch for each named view, and the intended paths (views, strokes, T, 3) [m] behind its strokes."""
    pages = _photographed(job, names) if job.cfg.user.draws_on == "photographs" else _rendered(job, names)
    hand = instantiate(job.cfg.user.hand)
    rng = np.random.default_rng(job.cfg.seed)
    spec, arm = mounted(job.settings("world"), instantiate(job.cfg.robot.arm))
    motion = varied(spec)["motion"]
    via = np.array([arm.fk(arm.home)[:3, 3], *motion["via"][1:]], dtype=float)  # whichever arm it is, its hand begins
    sketches, paths = [], []
    for page in pages:
        drawn, intended = scripted.sketch(page.name, page.true_camera, via, hand, rng, count=job.cfg.user.strokes, flow=page.flow,
                                          events=motion.get("events", ()))  # fmt: skip
        sketches.append(Sketch(page.name, page.camera, drawn.strokes))
        paths.append(intended)
    return sketches, np.stack(paths)


def _rendered(job: Job, names: list[str]) -> list[Page]:
    from robot.world import World

    views = {view.name: view for view in load_views(job.capture / "views")}
    with World.from_spec(job.settings("world")) as world:
        flows = {n: scripted.picture_flow(world.photograph(views[n].camera), views[n].image) for n in names}
    return [Page(n, views[n].camera, views[n].camera, flows[n]) for n in names]


def _photographed(job: Job, names: list[str]) -> list[Page]:
    """The photographs taken nearest to the views of those names."""
    true = json.loads((job.capture / "truth.json").read_text())["cameras"]
    taken = {view.name: view.camera for view in load_views(job.capture) if view.name in true}
    wanted = instantiate(job.cfg.scene.views)(list(taken.values()), job.settings("world.sketch_views")).sketch
    pages = []
    for name in names:
        nearest = min(taken, key=lambda photo: np.linalg.norm(taken[photo].centre - wanted[name].centre))
        pages.append(Page(name, taken[nearest], Camera(**true[nearest]), None))
    return pages
