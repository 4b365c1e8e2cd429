"""Answers about one skill: its file, what is learned of it, whether the arm can do it."""

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, Response

from teach.page.asked import WORK, Wrong, body_of, json_answer, name_of
from teach.page.page import Page
from teach.page.store import parse, revision_of
from teach.sketch import check


async def names(page: Page, request: Request) -> Response:
    return json_answer({"skills": await run_in_threadpool(page.store.names)})


async def read(page: Page, request: Request) -> Response:
    body = await run_in_threadpool(page.store.read, name_of(request))
    return Response(body, media_type="application/json", headers={"etag": f'"{revision_of(body)}"', "cache-control": "no-store"})


def _seen(request: Request) -> str | None:
    """The revision that the writer saw; None where they expect no such skill."""
    match, none = request.headers.get("if-match"), request.headers.get("if-none-match")
    if (match is None) == (none is None) or (none is not None and none != "*"):
        raise Wrong(428, 'say If-Match: "<revision>" of what you saw, or If-None-Match: * for a new skill', "If-Match")
    return None if match is None else match.strip('" ')


async def write(page: Page, request: Request) -> Response:
    name, seen = name_of(request), _seen(request)
    revision = await run_in_threadpool(page.store.write, name, await request.body(), seen)
    page.tell(name, {"type": "changed", "revision": revision, "tab": request.headers.get("x-tab", "")[:60]})
    return json_answer({"revision": revision}, 201 if seen is None else 200, etag=f'"{revision}"')


async def remove(page: Page, request: Request) -> Response:
    name = name_of(request)
    await run_in_threadpool(page.store.remove, name, _seen(request))
    page.tell(name, {"type": "changed", "revision": None, "tab": request.headers.get("x-tab", "")[:60]})
    return json_answer({"removed": name})


async def fit(page: Page, request: Request) -> Response:
    name, asked = name_of(request), await body_of(request, WORK)
    body = await run_in_threadpool(page.store.read, name)
    sketches = await run_in_threadpool(parse, body)
    check(sketches, page.scene.surfaces)
    learned = await page.work(request, "fit", asked["tab"], name, page.store.folder / f"{name}.json", page.file(".learned", name, ".npz"))
    return json_answer(learned)


async def plan(page: Page, request: Request) -> Response:
    name, asked = name_of(request), await body_of(request, WORK)
    skill = page.file(".learned", name, ".npz")
    if not skill.is_file():
        raise Wrong(409, "there is no motion to check yet: draw it on two views", "name")
    return json_answer(await page.work(request, "plan", asked["tab"], name, skill, page.file(".learned", name, ".plan.npz")))


async def perform(page: Page, request: Request) -> Response:
    name, asked = name_of(request), await body_of(request, WORK)
    plan = page.file(".learned", name, ".plan.npz")
    if not plan.is_file():
        raise Wrong(409, "there is no checked motion to perform yet: check it first", "name")
    skill, film = page.file(".learned", name, ".npz"), page.file(".learned", name, ".mp4")
    return json_answer(await page.work(request, "perform", asked["tab"], name, plan, skill, film))


async def video(page: Page, request: Request) -> Response:
    video = page.file(".learned", name_of(request), ".mp4")
    if not video.is_file():
        raise Wrong(404, "this skill has not been performed", "name")
    return FileResponse(video, media_type="video/mp4", headers={"cache-control": "no-store"})


async def done(page: Page, request: Request) -> Response:
    """The person is content: whoever opened the page goes on with this skill."""
    name = name_of(request)
    await body_of(request, WORK)
    sketches = await run_in_threadpool(lambda: parse(page.store.read(name)))
    check(sketches, page.scene.surfaces)
    if page.finished is None:
        raise Wrong(404, "nothing waits for this skill: it is saved", "path")
    page.finished(name, sketches)
    return json_answer({"done": name})
