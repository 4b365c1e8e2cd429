"""Answers about the scene: its views, its surface and points, pictures from anywhere, the arm, the next viewpoint."""

import hashlib
import io
import json
from pathlib import Path

from PIL import Image
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, Response

from scene.files import replacing
from teach.page.asked import RENDER, SUGGEST, WORK, Wrong, body_of, camera_of, json_answer
from teach.page.page import Page
from teach.page.solid import packed
from teach.page.store import checked_name, parse

SMALL = 320
"""Longer side of a small picture [px]."""


async def scene(page: Page, request: Request) -> Response:
    scene = page.scene
    views = [{"name": name, "kind": view.kind, "camera": view.camera.plain()} for name, view in scene.views.items()]
    can = {name: name in page.works for name in ("fit", "render", "suggest", "plan", "perform", "body")}
    can |= {"finish": page.finished is not None, "mesh": scene.mesh is not None}
    about = {"title": scene.title, "unit": scene.unit, "surfaces": list(scene.surfaces), "target": list(scene.target)}
    return json_answer(about | {"views": views, "can": can})


async def points(page: Page, request: Request) -> Response:
    return json_answer({"points": page.scene.points.round(4).tolist(), "colours": page.scene.colours.tolist()})


async def mesh(page: Page, request: Request) -> Response:
    """The scene's surface, as solid.py packs it."""
    if page.scene.mesh is None:
        raise Wrong(404, "this scene has no mesh: python -m scene.mesh makes it from a trained field", "path")
    solid = await run_in_threadpool(page.scene.mesh)
    return Response(await run_in_threadpool(packed, solid), media_type="application/octet-stream", headers={"content-encoding": "gzip"})


async def body(page: Page, request: Request) -> Response:
    """The arm's links as triangles, and where they are at home."""
    asked = await body_of(request, WORK)
    return json_answer(await page.work(request, "body", asked["tab"], None))


async def picture(page: Page, request: Request) -> Response:
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


async def render(page: Page, request: Request) -> Response:
    """What the field shows from a camera. keep: the picture is drawn on, so it is wanted again."""
    asked = await body_of(request, RENDER)
    camera = camera_of(asked["camera"])
    kept = page.file(".pictures", hashlib.sha256(json.dumps(camera.plain()).encode()).hexdigest()[:24], ".jpg")
    if kept.is_file():
        return FileResponse(kept, media_type="image/jpeg")
    image = await page.work(request, "render", asked["tab"], None, camera)
    picture = await run_in_threadpool(_jpeg, Image.fromarray(image))
    if asked.get("keep"):
        with replacing(kept) as temporary:
            temporary.write_bytes(picture)
    return Response(picture, media_type="image/jpeg")


async def suggest(page: Page, request: Request) -> Response:
    """A camera for the next sketch, and why."""
    asked = await body_of(request, SUGGEST)
    sketches = await run_in_threadpool(lambda: parse(page.store.read(checked_name(asked["skill"]))))
    camera, sentence = await page.work(request, "suggest", asked["tab"], asked["skill"], sketches)
    return json_answer({"camera": camera.plain(), "sentence": sentence})
