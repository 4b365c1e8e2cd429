"""What the scripted user sees and draws: the only place, beside evaluation, where the truth of a world is known.

On rendered views the picture itself is what a person goes by: where the field shows an object a few pixels off, the
stroke lands a few pixels off. So a stroke is displaced by the optical flow from a true picture at the same pose to the
shown one. On photographs the stroke is drawn with the true camera, while fitting knows the estimated one.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hydra.utils import instantiate

from conf import stages
from conf.stages import Job, Stage
from robot.mounting import mounted
from robot.variation import varied
from scene.camera import Camera
from scene.dataset import load_views
from scene.views import given, numbered
from teach import scripted
from teach.hand import scaled
from teach.sketch import Sketch


@dataclass(frozen=True)
class Page:
    """A picture to draw on. camera: what fitting knows; true_camera: where it was really taken; flow: (H, W, 2) [px] or None."""

    name: str
    camera: Camera
    true_camera: Camera
    flow: np.ndarray | None


def roles(views: list[str], judge: str | None) -> tuple[list[str], list[str]]:
    """Names of the views that teach, and of the one that judges (none where ``judge`` is None)."""
    if judge is not None and judge not in views:
        raise ValueError(f"user.held_out={judge} is none of the views that are drawn on, {', '.join(views)}: name one of them, or say user.held_out=null, "
                         "and none judges")  # fmt: skip
    return [name for name in views if name != judge], [name for name in views if name == judge]


def drawn_on(job: Job) -> list[str]:
    """Names of the views that are drawn on."""
    photographed = job.cfg.user.draws_on == "photographs"
    there = [f"view{i}" for i, _ in enumerate(job.settings("world.sketch_views"), start=1)] if photographed else list(_views(job))
    names = list(job.cfg.user.views or there)
    if unknown := [name for name in names if name not in there]:
        raise ValueError(f"there is no {', '.join(unknown)} to draw on: user.views may have {', '.join(there)}")
    return names


def draw(job: Job, names: list[str]) -> tuple[list[Sketch], np.ndarray, np.ndarray]:
    """One sketch for each named view, the intended paths (views, strokes, T, 3) [m] behind its strokes, and the path (T, 3) [m]
    that all of them are attempts at.
    """
    hand = scaled(instantiate(job.cfg.user.hand), job.cfg.user.clumsiness)
    rng = np.random.default_rng(job.cfg.seed)
    spec, arm = mounted(job.settings("world"), instantiate(job.cfg.robot.arm))
    motion = varied(spec)["motion"]
    via = np.array([arm.fk(arm.home)[:3, 3], *motion["via"][1:]], dtype=float)  # whichever arm it is, its hand begins
    path, sketches, paths = scripted.smooth_path(via), [], []
    for page in _photographed(job, names, path) if job.cfg.user.draws_on == "photographs" else _rendered(job, names):
        drawn, intended = scripted.sketch(page.name, page.true_camera, via, hand, rng, count=job.cfg.user.strokes, flow=page.flow,
                                          events=motion.get("events", ()))  # fmt: skip
        sketches.append(Sketch(page.name, page.camera, drawn.strokes))
        paths.append(intended)
    return sketches, np.stack(paths), path


def _rendered(job: Job, names: list[str]) -> list[Page]:
    views = _views(job)
    stages.run(FLOWS, job, {})
    with np.load(job.capture / "flows.npz", allow_pickle=False) as flows:
        return [Page(n, views[n].camera, views[n].camera, flows[n]) for n in names]


def _flows(job: Job, out: Path) -> dict:
    """How far what each rendered view shows is from where it truly is; hands differ, this does not."""
    from robot.world import World

    with World.from_spec(job.settings("world")) as world:
        flows = {name: scripted.picture_flow(world.photograph(view.camera), view.image) for name, view in _views(job).items()}
    np.savez(out / "flows.npz", **{name: flow.astype(np.float32) for name, flow in flows.items()})
    return {}


def _shown(job: Job) -> str:
    """The contents of the views."""
    parts = [(name, view.camera.plain(), hashlib.sha256(view.image.tobytes()).hexdigest()) for name, view in _views(job).items()]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


FLOWS = Stage("flows", _flows, ("flows.npz",), settings=("world",), inputs=_shown, shared=True)


def _views(job: Job) -> dict:
    return {view.name: view for view in load_views(job.capture / "views")}


def _shows(camera: Camera, path) -> bool:
    """Whether the motion is in the picture, with a tenth of it to spare on all sides for the hand."""
    seen, size = camera.project(path), np.array([camera.width, camera.height])
    return bool((np.isfinite(seen) & (seen > 0.1 * size) & (seen < 0.9 * size)).all())


def _photographed(job: Job, names: list[str], path) -> list[Page]:
    """The photographs taken nearest to the views of those names, each once, of those that show all of the path (T, 3) [m]."""
    true = json.loads((job.capture / "truth.json").read_text())["cameras"]
    taken = {view.name: view.camera for view in load_views(job.capture) if view.name in true}
    taken = {name: camera for name, camera in taken.items() if _shows(camera, path)} or taken
    eyes = numbered(given(varied(job.settings("world"))["sketch_views"]))
    pages = []
    for name in names:
        left = [photo for photo in taken if photo not in [page.name for page in pages]]
        if not left:
            raise ValueError(f"{len(names)} views are to be drawn on, and there are {len(taken)} photographs: set user.views")
        nearest = min(left, key=lambda photo: np.linalg.norm(taken[photo].centre - eyes[name].centre))
        camera = taken[nearest]
        pages.append(Page(nearest, camera, Camera(**true[nearest]).resized(camera.width, camera.height), None))
    return pages
