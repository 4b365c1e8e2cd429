"""What the sketching page is handed of the rooms downstream of teach: functions for its worker processes.

Each ``make`` below is called in a process of its own and returns what the page may ask for there; settings travel as plain
values, since a process cannot be sent a world or an arm.
"""

import logging
import secrets
import socket
from functools import cache, partial
from pathlib import Path

import numpy as np
from hydra.utils import instantiate

from conf.body import body, link_rows
from conf.rendering import workspace
from conf.stages import Job
from scene.dataset import load_cameras, load_frame, load_points
from teach.page.guard import LOOPBACK
from teach.sketch import Sketch

log = logging.getLogger("scene2skill")

TOLERANCE = 2e-3
"""Position error [m] beyond which the page says that the arm does not follow the drawn motion."""
MARGIN = 0.01
"""Clearance [m] below which the page says that the arm touches."""


def draw_by_hand(job: Job) -> tuple[str, list[Sketch]]:
    """Serve the page until the person is done with a skill; its name and sketches. Raises KeyboardInterrupt, OSError."""
    import uvicorn

    from teach.page.server import Page, create
    from teach.page.store import Store

    user, chosen = job.cfg.user, []
    token = None if user.host in LOOPBACK else secrets.token_urlsafe(16)

    def finished(name, sketches):
        chosen.append((name, sketches))
        server.should_exit = True

    page = Page(Store(job.capture / "sketches"), scene_of(job), works_of(job), finished)
    app = create(page, hosts=LOOPBACK if token is None else None, token=token)
    settings = {"log_level": "warning", "ws_max_size": 2**16, "timeout_graceful_shutdown": 2, "loop": "asyncio"}
    server = uvicorn.Server(uvicorn.Config(app, **settings))
    with _listening(user.host, user.port) as listener:
        address = f"http://{_shown(user.host)}:{listener.getsockname()[1]}/" + (f"?token={token}" if token else "")
        log.info("  draw at %s\n  every stroke is saved in %s; press Done there when the motion is right", address, page.store.folder)
        server.run(sockets=[listener])
    if not chosen:
        raise KeyboardInterrupt
    return chosen[-1]


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise OSError(f"the page cannot listen on {host} port {port} ({error.strerror}); say user.port=0 for any free one") from None


def _shown(host: str) -> str:
    return {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(host, f"[{host}]" if ":" in host else host)


def scene_of(job: Job):
    """The views of a capture folder: those rendered to sketch on first, then the photographs. A scene that is known from truth has
    none of these, and no reconstruction: its surface is what the views' depth pictures show."""
    from scene.views import load_depths
    from teach.page.scene import Picture, Scene

    known = (job.capture / "transforms.json").exists()
    rendered, photographs = load_cameras(job.capture / "views"), load_cameras(job.capture) if known else {}
    views = {path.stem: Picture(path, camera, "rendered") for path, camera in rendered.items()}
    views |= {p.stem: Picture(p, camera, "photograph") for p, camera in photographs.items() if p.stem not in views}
    points, colours = load_points(job.capture) if known else (np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    surfaces = load_depths(job.capture / "views", {name: view.camera for name, view in views.items()})
    target = np.median(points, axis=0) if len(points) else _looked_at(list(rendered.values()))
    unit = load_frame(job.capture if known else job.capture / "views")["unit"]
    return Scene(job.capture.name, views, points, colours, unit, tuple(surfaces), tuple(target.tolist()), _surface(job, known))


def _looked_at(cameras) -> np.ndarray:
    """(3,) [m]: the point nearest to the axes of all cameras."""
    across = [np.eye(3) - np.outer(camera.forward, camera.forward) for camera in cameras]
    return np.linalg.lstsq(sum(across), sum(A @ camera.centre for A, camera in zip(across, cameras)), rcond=None)[0]


def _surface(job: Job, known: bool):
    """What makes the scene's surface, when it is first looked at; None where there is none."""
    if (job.capture / "mesh.ply").exists():
        return cache(partial(surface_of, job.capture / "mesh.ply"))
    return None if known else cache(partial(surface_of_views, job.capture / "views"))


def surface_of_views(folder: Path):
    """What the views of a folder see of the scene, by their depth pictures, as the page shows it."""
    from scene.dataset import load_views
    from scene.views import load_depths
    from teach.page.solid import relief

    views = load_views(folder)
    depths = load_depths(folder, {view.name: view.camera for view in views})
    return relief([(view.camera, view.image, depths[view.name]) for view in views if view.name in depths])


def surface_of(path: Path):
    """The mesh of a capture folder as the page shows it."""
    from scene.surface import Mesh
    from teach.page.solid import thinned

    mesh = Mesh.load(path)
    return thinned(mesh.vertices, mesh.faces, mesh.colours)


def works_of(job: Job) -> dict:
    """The page's workers, by what they do."""
    from teach.page.worker import Worker

    teach = {part: job.settings(f"teach.{part}") for part in ("rptl", "raytrace", "basis")}
    teach["density"] = job.settings("user.density") or job.settings("teach.density")
    works = {"fit": Worker(partial(learning, teach, job.cfg.seed, job.capture / "views"))}
    if (job.capture / "field.pt").exists():
        works["render"] = Worker(partial(rendering, job.capture / "field.pt"))
        works["suggest"] = Worker(partial(suggesting, job.settings("scene.viewpoints"), workspace(job), job.capture))
    if not job.cfg.photos:  # of photographs there is no world yet to check and perform in
        robot = {part: job.settings(f"robot.{part}") for part in ("arm", "planner", "execution")}
        works["body"] = works["plan"] = works["perform"] = Worker(partial(performing, robot, job.settings("world"), job.cfg.seed))
    return works


def learning(settings: dict, seed: int, views: Path) -> dict:
    """make: {"fit": ...}."""
    from scene.views import load_depths
    from teach.page.learned import learn

    parts = {name: instantiate(setting, _convert_="all") for name, setting in settings.items()}
    rptl = partial(parts.pop("rptl"), seed=seed, **parts)

    def fit(sketches, seen):
        return rptl(sketches, depths=load_depths(views, {s.view: s.camera for s in sketches}), seen=seen)

    return {"fit": partial(learn, fit)}


def rendering(path: Path) -> dict:
    """make: {"render": ...}."""
    from scene.camera import Camera
    from scene.field import Field

    field = Field.load(path)
    field.render(Camera.from_fov(np.eye(4), 16, 12, 60))  # compiles what the first picture would wait for
    return {"render": lambda progress, camera: field.render(camera)[0]}


def suggesting(settings: dict, workspace: list | None, capture: Path) -> dict:
    """make: {"suggest": ...}."""
    from scene.field import Field

    photographed = list(load_cameras(capture).values())
    propose = instantiate(settings, _convert_="all")
    field = Field.load(capture / "field.pt")

    def suggest(progress, sketches):
        drawn = [sketch for sketch in sketches if sketch.motions]
        progress(0.2, "Looking for the view that leaves least of the motion open")
        strokes = [sketch.motions[0].points for sketch in drawn]
        found = propose(photographed, [sketch.camera for sketch in drawn], strokes, field=field, workspace=workspace)
        return found.cameras[0], found.why

    return {"suggest": suggest}


def performing(settings: dict, spec: dict, seed: int) -> dict:
    """make: {"body": ..., "plan": ..., "perform": ...}."""
    from robot.mounting import mounted

    parts = {name: instantiate(setting, _convert_="all") for name, setting in settings.items()}
    spec, parts["arm"] = mounted(spec, parts["arm"])
    return {
        "body": lambda progress: body(parts["arm"]),
        "plan": partial(_plan, parts["planner"], parts["arm"], spec, seed),
        "perform": partial(_perform, parts["execution"], parts["arm"], spec),
    }


def _plan(planner, arm, spec, seed, progress, skill: Path, keep: Path) -> dict:
    from robot.contact import as_planned
    from robot.events import planned_events
    from robot.world import World
    from teach.trajectory import Skill

    progress(0.1, "Looking for a way for the arm")
    learned = Skill.load(skill)
    with World.from_spec(spec, textured=False) as world:
        world.bring_held(arm, arm.home)
        chosen = planner(learned, arm, world.obstacles, start=arm.home, seed=seed)
    chosen.save(keep)
    events = planned_events(learned, chosen)
    links = link_rows(as_planned(arm, chosen), chosen.times, chosen.joints, events, _shown_rows(chosen))
    return planned(chosen) | {"links": links, "events": [{"name": event.name, "time": event.time} for event in events]}


def _shown_rows(plan) -> np.ndarray:
    return np.linspace(0, len(plan.times) - 1, min(len(plan.times), 200)).astype(int)


def planned(plan) -> dict:
    """Plain numbers of a Plan: tip (T, 3) [m] at times (T,) [s], clearance [m], what is wrong and where along the way."""
    rows = _shown_rows(plan)
    clearance = np.minimum(plan.clearance, plan.self_clearance)
    touches, strays = clearance < MARGIN, plan.position_error > TOLERANCE
    return {
        "feasible": bool(plan.feasible),
        "sentence": plan.sentence,
        "refusals": list(plan.refusals[:6]),
        "times": plan.times[rows].round(4).tolist(),
        "tip": plan.tip[rows].round(4).tolist(),
        "clearance_mm": (1e3 * clearance[rows]).round(1).tolist(),
        "touches": touches[rows].tolist(),
        "strays": strays[rows].tolist(),
        "least_mm": round(float(1e3 * clearance.min()), 1),
        "duration": float(plan.times[-1]),
    }


def _perform(execution, arm, spec, progress, plan: Path, skill: Path, keep: Path) -> dict:
    from robot.events import planned_events
    from robot.execution import save_video
    from robot.planner import Plan
    from robot.world import World
    from teach.trajectory import Skill

    chosen = Plan.load(plan)
    if not chosen.feasible:
        raise ValueError(f"the motion is not performed: {chosen.sentence}")
    progress(0.1, "The arm performs it in simulation")
    with World.from_spec(spec) as world:
        performed = execution(chosen, arm, world, events=planned_events(Skill.load(skill), chosen))
    progress(0.9, "Writing the film")
    save_video(keep, performed.frames, performed.fps)
    return {"sentence": performed.sentence, "metrics": performed.metrics}
