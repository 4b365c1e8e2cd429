"""The page's server: a Starlette app over the files of a capture folder.

    /                         the page                        /static/...             its modules
    /api/scene                views, cameras, what is possible /pictures/<view>?small  a view's picture
    /api/points               sparse points for the 3D view    /api/render             any viewpoint, by the field
    /api/suggest              a viewpoint for the next sketch
    /api/skills               names                           /api/skills/<name>      GET, PUT, DELETE one, by revision (ETag)
    /api/skills/<name>/fit    the motion that it draws        .../plan, .../perform, .../video, .../done
    /live?skill=<name>        WebSocket: progress, and that another page changed the skill

Nothing is kept but in files (store.py). Every answer to a bad request is JSON, {"error": sentence, "field": what is at fault}.
What lies downstream of teach (rendering, planning, performing) comes as functions of a Worker; without them it is off.
"""

import asyncio
import hashlib
import io
import json
from collections.abc import Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from PIL import Image
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from scene.files import replacing
from teach.page.asked import RENDER, SUGGEST, WORK, Wrong, answering, body_of, camera_of, json_answer, name_of, not_found
from teach.page.guard import LOOPBACK, Guard
from teach.page.scene import Scene
from teach.page.store import MAX_BODY, Store, checked_name, parse, revision_of
from teach.page.worker import Worker
from teach.sketch import SketchError, check

STATIC = Path(__file__).parent / "static"
SMALL = 320
"""Longer side of a small picture [px]."""


@dataclass(eq=False)
class Page:
    """What a request needs. works: which Worker does "fit", "render", "suggest", "plan", "perform"; a missing one is off.
    finished(name, sketches) is called when a person is done with a skill; None: there is nothing to be done with it."""

    store: Store
    scene: Scene
    works: Mapping[str, Worker] = field(default_factory=dict)
    finished: Callable | None = None
    sockets: dict[str, set[WebSocket]] = field(default_factory=dict)
    telling: set = field(default_factory=set)

    def tell(self, skill: str, message: dict) -> None:
        """Tell all pages that show a skill."""
        for socket in tuple(self.sockets.get(skill, ())):
            task = asyncio.ensure_future(_send(socket, message))
            self.telling.add(task)
            task.add_done_callback(self.telling.discard)

    def file(self, folder: str, name: str, ending: str) -> Path:
        """Where what was made of a skill is kept."""
        folder = self.store.folder / folder
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{name}{ending}"


def create(page: Page, hosts=LOOPBACK, token: str | None = None) -> Starlette:
    """The app. hosts: names of this machine (None: any, with a token). token: what a browser must show."""

    @asynccontextmanager
    async def lifespan(app):
        for worker in set(page.works.values()):
            worker.start()
        yield
        for worker in set(page.works.values()):
            worker.close()

    one = "/api/skills/{name}"
    routes = [
        Route("/", partial(_file, STATIC / "index.html")),
        Mount("/static", _Fresh(directory=STATIC)),
        Route("/pictures/{view}", answering(_picture)),
        Route("/api/scene", answering(_scene)),
        Route("/api/points", answering(_points)),
        Route("/api/render", answering(_render), methods=["POST"]),
        Route("/api/suggest", answering(_suggest), methods=["POST"]),
        Route("/api/skills", answering(_names)),
        Route(one, answering(_read), methods=["GET"]),
        Route(one, answering(_write), methods=["PUT"]),
        Route(one, answering(_remove), methods=["DELETE"]),
        Route(f"{one}/fit", answering(_fit), methods=["POST"]),
        Route(f"{one}/plan", answering(_plan), methods=["POST"]),
        Route(f"{one}/perform", answering(_perform), methods=["POST"]),
        Route(f"{one}/video", answering(_video)),
        Route(f"{one}/done", answering(_done), methods=["POST"]),
        WebSocketRoute("/live", _live),
    ]
    guard = Middleware(Guard, hosts=hosts, token=token, max_body=MAX_BODY)
    app = Starlette(routes=routes, middleware=[guard], lifespan=lifespan, exception_handlers={HTTPException: not_found})
    app.state.page = page
    return app


class _Fresh(StaticFiles):
    """Modules that belong together are never mixed with older ones from a cache."""

    def file_response(self, *arguments, **settings):
        response = super().file_response(*arguments, **settings)
        response.headers["cache-control"] = "no-cache"
        return response


async def _file(path: Path, request: Request) -> Response:
    return FileResponse(path, headers={"cache-control": "no-cache"})


async def _scene(page: Page, request: Request) -> Response:
    scene = page.scene
    views = [{"name": name, "kind": view.kind, "camera": view.camera.plain()} for name, view in scene.views.items()]
    can = {name: name in page.works for name in ("fit", "render", "suggest", "plan", "perform")} | {"finish": page.finished is not None}
    about = {"title": scene.title, "unit": scene.unit, "surfaces": list(scene.surfaces), "target": list(scene.target)}
    return json_answer(about | {"views": views, "can": can})


async def _points(page: Page, request: Request) -> Response:
    return json_answer({"points": page.scene.points.round(4).tolist(), "colours": page.scene.colours.tolist()})


async def _picture(page: Page, request: Request) -> Response:
    view = page.scene.views.get(request.path_params["view"])
    if view is None or not view.path.is_file():
        raise Wrong(404, "there is no view of this name", "view")
    if "small" not in request.query_params:
        return FileResponse(view.path, headers={"cache-control": "no-cache"})
    return Response(await run_in_threadpool(_small, view.path), media_type="image/jpeg", headers={"cache-control": "max-age=300"})


def _small(path: Path) -> bytes:
    with Image.open(path) as image:
        image = image.convert("RGB")
        image.thumbnail((SMALL, SMALL))
        return _jpeg(image)


def _jpeg(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=92, subsampling=0)
    return buffer.getvalue()


async def _render(page: Page, request: Request) -> Response:
    """What the field shows from a camera. keep: the picture is drawn on, so it is wanted again."""
    asked = await body_of(request, RENDER)
    camera = camera_of(asked["camera"])
    kept = page.file(".pictures", hashlib.sha256(json.dumps(camera.plain()).encode()).hexdigest()[:24], ".jpg")
    if kept.is_file():
        return FileResponse(kept, media_type="image/jpeg")
    image = await _work(page, request, "render", asked["tab"], None, camera)
    picture = await run_in_threadpool(_jpeg, Image.fromarray(image))
    if asked.get("keep"):
        with replacing(kept) as temporary:
            temporary.write_bytes(picture)
    return Response(picture, media_type="image/jpeg")


async def _suggest(page: Page, request: Request) -> Response:
    """A camera for the next sketch, and why."""
    asked = await body_of(request, SUGGEST)
    sketches = await run_in_threadpool(lambda: parse(page.store.read(checked_name(asked["skill"]))))
    camera, sentence = await _work(page, request, "suggest", asked["tab"], asked["skill"], sketches)
    return json_answer({"camera": camera.plain(), "sentence": sentence})


async def _names(page: Page, request: Request) -> Response:
    return json_answer({"skills": await run_in_threadpool(page.store.names)})


async def _read(page: Page, request: Request) -> Response:
    body = await run_in_threadpool(page.store.read, name_of(request))
    return Response(body, media_type="application/json", headers={"etag": f'"{revision_of(body)}"', "cache-control": "no-store"})


def _seen(request: Request) -> str | None:
    """The revision that the writer saw; None where they expect no such skill."""
    match, none = request.headers.get("if-match"), request.headers.get("if-none-match")
    if (match is None) == (none is None) or (none is not None and none != "*"):
        raise Wrong(428, 'say If-Match: "<revision>" of what you saw, or If-None-Match: * for a new skill', "If-Match")
    return None if match is None else match.strip('" ')


async def _write(page: Page, request: Request) -> Response:
    name, seen = name_of(request), _seen(request)
    revision = await run_in_threadpool(page.store.write, name, await request.body(), seen)
    page.tell(name, {"type": "changed", "revision": revision, "tab": request.headers.get("x-tab", "")[:60]})
    return json_answer({"revision": revision}, 201 if seen is None else 200, etag=f'"{revision}"')


async def _remove(page: Page, request: Request) -> Response:
    name = name_of(request)
    await run_in_threadpool(page.store.remove, name, _seen(request))
    page.tell(name, {"type": "changed", "revision": None, "tab": request.headers.get("x-tab", "")[:60]})
    return json_answer({"removed": name})


async def _work(page: Page, request: Request, work: str, tab: str, skill: str | None, *arguments):
    """Have a worker do it; told of it are the pages of the skill, and a page that leaves stops it."""
    if work not in page.works:
        raise Wrong(404, f"{work} is off: this page was opened without it", "path")
    key, worker = f"{tab}:{'robot' if work in ('plan', 'perform') else work}", page.works[work]
    told = lambda share, words: page.tell(skill, {"type": "progress", "work": work, "share": share, "words": words, "tab": tab})
    dropped = asyncio.Event()
    leaving = asyncio.ensure_future(_left(request, dropped))
    try:
        return await worker.do(key, work, *arguments, told=told, dropped=dropped)
    finally:
        leaving.cancel()


async def _left(request: Request, dropped: asyncio.Event) -> None:
    while not await request.is_disconnected():
        await asyncio.sleep(0.1)
    dropped.set()


async def _fit(page: Page, request: Request) -> Response:
    name, asked = name_of(request), await body_of(request, WORK)
    body = await run_in_threadpool(page.store.read, name)
    sketches = await run_in_threadpool(parse, body)
    check(sketches, page.scene.surfaces)
    learned = await _work(page, request, "fit", asked["tab"], name, page.store.folder / f"{name}.json", page.file(".learned", name, ".npz"))
    return json_answer(learned)


async def _plan(page: Page, request: Request) -> Response:
    name, asked = name_of(request), await body_of(request, WORK)
    skill = page.file(".learned", name, ".npz")
    if not skill.is_file():
        raise Wrong(409, "there is no motion to check yet: draw it on two views", "name")
    return json_answer(await _work(page, request, "plan", asked["tab"], name, skill, page.file(".learned", name, ".plan.npz")))


async def _perform(page: Page, request: Request) -> Response:
    name, asked = name_of(request), await body_of(request, WORK)
    plan = page.file(".learned", name, ".plan.npz")
    if not plan.is_file():
        raise Wrong(409, "there is no checked motion to perform yet: check it first", "name")
    skill, film = page.file(".learned", name, ".npz"), page.file(".learned", name, ".mp4")
    return json_answer(await _work(page, request, "perform", asked["tab"], name, plan, skill, film))


async def _video(page: Page, request: Request) -> Response:
    video = page.file(".learned", name_of(request), ".mp4")
    if not video.is_file():
        raise Wrong(404, "this skill has not been performed", "name")
    return FileResponse(video, media_type="video/mp4", headers={"cache-control": "no-store"})


async def _done(page: Page, request: Request) -> Response:
    """The person is content: whoever opened the page goes on with this skill."""
    name = name_of(request)
    await body_of(request, WORK)
    sketches = await run_in_threadpool(lambda: parse(page.store.read(name)))
    check(sketches, page.scene.surfaces)
    if page.finished is None:
        raise Wrong(404, "nothing waits for this skill: it is saved", "path")
    page.finished(name, sketches)
    return json_answer({"done": name})


async def _live(socket: WebSocket) -> None:
    page: Page = socket.app.state.page
    try:
        name = checked_name(socket.query_params.get("skill", ""))
    except SketchError:
        return await socket.close(4000)
    await socket.accept()
    page.sockets.setdefault(name, set()).add(socket)
    try:
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass
    except WebSocketDisconnect:
        pass
    finally:
        page.sockets[name].discard(socket)
        if not page.sockets[name]:
            del page.sockets[name]


async def _send(socket: WebSocket, message: dict) -> None:
    try:
        await socket.send_json(message)
    except (WebSocketDisconnect, RuntimeError):  # it left in between
        pass
