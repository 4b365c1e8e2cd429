"""The page's server: a Starlette app over the files of a capture folder.

    /                         the page                        /static/...             its modules
    /api/scene                views, cameras, what is possible /pictures/<view>?small  a view's picture
    /api/points               sparse points for the 3D view    /api/render             any viewpoint, by the field
    /api/mesh                 its surface, where there is one  /api/body               the arm's links as triangles
    /api/suggest              a viewpoint for the next sketch
    /api/skills               names                           /api/skills/<name>      GET, PUT, DELETE one, by revision (ETag)
    /api/skills/<name>/fit    the motion that it draws        .../plan, .../perform, .../video, .../done
    /live?skill=<name>        WebSocket: progress, and that another page changed the skill

Nothing is kept but in files (store.py). Every answer to a bad request is JSON, {"error": sentence, "field": what is at fault}.
What lies downstream of teach (rendering, planning, performing) comes as functions of a Worker; without them it is off.
"""

from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from teach.page import looking, skills
from teach.page.asked import answering, not_found
from teach.page.guard import LOOPBACK, Guard
from teach.page.page import Page
from teach.page.store import MAX_BODY, checked_name
from teach.sketch import SketchError

STATIC = Path(__file__).parent / "static"


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
        Route("/pictures/{view}", answering(looking.picture)),
        Route("/api/scene", answering(looking.scene)),
        Route("/api/points", answering(looking.points)),
        Route("/api/mesh", answering(looking.mesh)),
        Route("/api/body", answering(looking.body), methods=["POST"]),
        Route("/api/render", answering(looking.render), methods=["POST"]),
        Route("/api/suggest", answering(looking.suggest), methods=["POST"]),
        Route("/api/skills", answering(skills.names)),
        Route(one, answering(skills.read), methods=["GET"]),
        Route(one, answering(skills.write), methods=["PUT"]),
        Route(one, answering(skills.remove), methods=["DELETE"]),
        Route(f"{one}/fit", answering(skills.fit), methods=["POST"]),
        Route(f"{one}/plan", answering(skills.plan), methods=["POST"]),
        Route(f"{one}/perform", answering(skills.perform), methods=["POST"]),
        Route(f"{one}/video", answering(skills.video)),
        Route(f"{one}/done", answering(skills.done), methods=["POST"]),
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
