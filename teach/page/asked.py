"""What a request may say, and how it is answered: bad ones in JSON, {"error": sentence, "field": what is at fault}."""

import json
import re
from functools import wraps

import numpy as np
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from scene.camera import Camera
from teach.page.store import Conflict, checked_name
from teach.page.worker import Refused, Superseded
from teach.schema import SCHEMA, validate
from teach.sketch import SketchError

LARGEST = 1600
"""Longer side of a rendered picture [px]."""

FIELDS = ("name", "sketches", "schema", "version", "camera", "tab", "skill", "keep", "orientation")
"""What a message about a field can begin with, beside paths with an index."""

_CAMERA = SCHEMA["properties"]["sketches"]["items"]["properties"]["camera"]
RENDER = {"type": "object", "required": ["camera", "tab"], "properties": {"camera": _CAMERA, "tab": {"type": "string"}, "keep": {"enum": [1]}}}
SUGGEST = {"type": "object", "required": ["skill", "tab"], "properties": {"skill": {"type": "string"}, "tab": {"type": "string"}}}
WORK = {"type": "object", "required": ["tab"], "properties": {"tab": {"type": "string"}}}


class Wrong(Exception):
    """A request that cannot be met: status, sentence, the field at fault."""

    def __init__(self, status: int, error: str, at: str | None = None, **more):
        super().__init__(error)
        self.status, self.body = status, {"error": error, "field": at or field_of(error)} | more


def answering(handler):
    """Errors that a caller caused become answers in JSON."""

    @wraps(handler)
    async def handle(request: Request) -> Response:
        try:
            return await handler(request.app.state.page, request)
        except Wrong as wrong:
            return json_answer(wrong.body, wrong.status)
        except Conflict as conflict:
            return json_answer({"error": str(conflict), "field": "If-Match", "revision": conflict.revision}, 412)
        except Superseded:
            return json_answer({"error": "a newer request took its place", "field": "tab"}, 409)
        except FileNotFoundError as error:
            return json_answer({"error": str(error), "field": "name"}, 404)
        except (SketchError, Refused) as error:
            return json_answer({"error": str(error), "field": field_of(str(error)) or "body"}, 422)
        except ClientDisconnect:
            return json_answer({"error": "the page went away", "field": None}, 400)

    return handle


def json_answer(value, status: int = 200, **headers) -> Response:
    # ASCII only: a lone surrogate in a name has no UTF-8
    return Response(json.dumps(value, allow_nan=False), status, headers, "application/json")


async def not_found(request: Request, error: HTTPException) -> Response:
    return json_answer({"error": f"{request.method} {request.url.path[:100]}: {error.detail}", "field": "path"}, error.status_code)


def field_of(message: str) -> str | None:
    """The path that a message of teach.schema begins with, such as sketches[0].view."""
    found = re.match(r"[A-Za-z_]\w*(?:[.\[][\w.\[\]]*)?(?=:? )", message)
    return found[0] if found and ("[" in found[0] or found[0].split(".")[0] in FIELDS) else None


async def body_of(request: Request, schema: dict) -> dict:
    """The request's JSON, checked."""
    try:
        value = json.loads((await request.body()).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise Wrong(400, f"the body is not JSON ({str(error)[:100]})", "body") from None
    try:
        validate(value, schema, "")
    except ValueError as error:
        raise Wrong(422, str(error).replace("the file", "the body")) from None
    return value


def camera_of(plain: dict) -> Camera:
    try:
        camera = Camera(**plain)
    except ValueError as error:
        raise Wrong(422, f"camera: {error}", "camera") from None
    if not (8 <= camera.width <= LARGEST and 8 <= camera.height <= LARGEST):
        raise Wrong(422, f"camera.width and height must be from 8 to {LARGEST} px", "camera.width")
    if not (1 <= min(camera.K[0, 0], camera.K[1, 1]) and np.abs(camera.K).max() <= 1e6 and (camera.K[2] == (0, 0, 1)).all()):
        raise Wrong(422, "camera.K has no usable focal length [px]", "camera.K")
    if np.abs(camera.world_from_camera).max() > 1e6:
        raise Wrong(422, "camera.world_from_camera is too far away", "camera.world_from_camera")
    return camera


def name_of(request: Request) -> str:
    return checked_name(request.path_params["name"])


