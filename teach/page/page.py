"""What every request of the page needs: the skills on disk, the scene, the workers, and who looks at which skill."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from starlette.requests import Request
from starlette.websockets import WebSocket, WebSocketDisconnect

from teach.page.asked import Wrong
from teach.page.scene import Scene
from teach.page.store import Store
from teach.page.worker import Worker


@dataclass(eq=False)
class Page:
    """What a request needs. works: which Worker does "fit", "render", "suggest", "plan", "perform", "body"; a missing one is off.
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

    async def work(self, request: Request, work: str, tab: str, skill: str | None, *arguments):
        """Have a worker do it; told of it are the pages of the skill, and a page that leaves stops it."""
        if work not in self.works:
            raise Wrong(404, f"{work} is off: this page was opened without it", "path")
        key, worker = f"{tab}:{'robot' if work in ('plan', 'perform') else work}", self.works[work]
        told = lambda share, words: self.tell(skill, {"type": "progress", "work": work, "share": share, "words": words, "tab": tab})
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


async def _send(socket: WebSocket, message: dict) -> None:
    try:
        await socket.send_json(message)
    except (WebSocketDisconnect, RuntimeError):  # it left in between
        pass
