"""The page's server: every route, every refusal in words, no 5xx whatever is sent."""

import json
from urllib.parse import quote

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from starlette.testclient import TestClient

from scene.camera import Camera, look_at
from teach.page.scene import Picture, Scene
from teach.page.server import Page, create
from teach.page.solid import Solid
from teach.page.store import Store
from teach.page.worker import Worker
from teach.sketch import Sketch, Stroke, dumps

VIEWS = {
    "view1": Camera.from_fov(look_at([1.0, 0.5, 1.0], [0, 0, 0]), 64, 48, 50),
    "view2": Camera.from_fov(look_at([0.5, -1.0, 1.0], [0, 0, 0]), 64, 48, 50),
}
HERE = {"host": "127.0.0.1:8765", "origin": "http://127.0.0.1:8765"}


def render(progress, camera):
    return np.full((camera.height, camera.width, 3), 99, np.uint8)


def make():
    return {"render": render}


def scene(folder) -> Scene:
    for name in VIEWS:
        Image.new("RGB", (64, 48), "teal").save(folder / f"{name}.png")
    views = {name: Picture(folder / f"{name}.png", camera, "rendered") for name, camera in VIEWS.items()}
    mesh = lambda: Solid(np.eye(3), np.array([[0, 1, 2]]), np.full((3, 3), 7, np.uint8))
    return Scene("table", views, np.zeros((3, 3)), np.full((3, 3), 7, np.uint8), surfaces=("view1",), mesh=mesh)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder, done = tmp_path_factory.mktemp("capture"), []
    page = Page(Store(folder / "sketches"), scene(folder), {"render": Worker(make)}, lambda name, sketches: done.append(name))
    page.done = done
    return page


@pytest.fixture(scope="module")
def client(page):
    with TestClient(create(page), base_url="http://127.0.0.1:8765", headers=HERE, raise_server_exceptions=True) as client:
        yield client


def text(views=("view1", "view2"), seed=0, n=20) -> str:
    points = np.random.default_rng(seed).uniform(10, 40, (n, 2))
    return dumps([Sketch(name, VIEWS[name], [Stroke(points, np.arange(n) / 240)]) for name in views])


def put(client, name, body, seen=None, **headers):
    headers |= {"content-type": "application/json"} | ({"if-match": f'"{seen}"'} if seen else {"if-none-match": "*"})
    return client.put(f"/api/skills/{name}", content=body, headers=headers)


def plain(camera: Camera) -> dict:
    return {"K": camera.K.tolist(), "world_from_camera": camera.world_from_camera.tolist(), "width": camera.width, "height": camera.height}


def test_the_page_and_its_parts_are_served_and_allow_nothing_foreign(client):
    start = client.get("/")
    assert start.status_code == 200 and "default-src 'self'" in start.headers["content-security-policy"]
    assert "https://" not in start.text and "http://" not in start.text
    assert client.get("/static/geometry.js").headers["content-type"].startswith("text/javascript")
    about = client.get("/api/scene").json()
    assert [view["name"] for view in about["views"]] == ["view1", "view2"]
    assert about["can"] == {"fit": False, "render": True, "suggest": False, "plan": False, "perform": False, "body": False, "finish": True, "mesh": True}
    assert client.get("/pictures/view1").headers["content-type"] == "image/png"
    assert client.get("/pictures/view1?small").headers["content-type"] == "image/jpeg"
    assert len(client.get("/api/points").json()["points"]) == 3
    surface = client.get("/api/mesh").content
    assert np.frombuffer(surface[:8], "<u4").tolist() == [3, 1] and len(surface) == 32 + 3 * (6 + 3) + 6
    assert client.post("/api/body", json={"tab": "t"}).status_code == 404


def test_a_skill_is_kept_by_revision(client):
    assert client.get("/api/skills/kept").status_code == 404
    first = put(client, "kept", text())
    assert first.status_code == 201
    there = client.get("/api/skills/kept")
    assert there.text == text() and there.headers["etag"].strip('"') == first.json()["revision"]
    second = put(client, "kept", text(seed=1), first.json()["revision"])
    late = put(client, "kept", text(seed=2), first.json()["revision"])
    assert late.status_code == 412 and late.json()["revision"] == second.json()["revision"]
    assert put(client, "kept", text(seed=2)).status_code == 412
    assert client.get("/api/skills/kept").text == text(seed=1)
    assert client.put("/api/skills/kept", content=text(), headers={"content-type": "application/json"}).status_code == 428


def test_other_pages_hear_of_a_change(client):
    with client.websocket_connect("/live?skill=heard", headers=HERE) as socket:
        revision = put(client, "heard", text(), **{"x-tab": "me"}).json()["revision"]
        assert socket.receive_json() == {"type": "changed", "revision": revision, "tab": "me"}


@pytest.mark.parametrize(
    ("body", "field"),
    [("[]", None), ("{", None), ('{"schema": "x"}', "version"), (text().replace('"view1"', "1"), "sketches[0].view"), (text().replace('"times": [0.0', '"times": [NaN'), "sketches[0].strokes[0].times")],
)
def test_a_wrong_skill_is_refused_by_field_and_not_kept(client, body, field):
    answer = put(client, "wrong", body)
    assert answer.status_code == 422 and answer.json()["error"]
    assert (answer.json()["field"] or "").startswith(field or "") or field in answer.json()["error"]
    assert client.get("/api/skills/wrong").status_code == 404


@pytest.mark.parametrize("name", ["..", "%2e%2e%2fpasswd", "a%2fb", ".x", "%00", "a%5cb"])
def test_names_never_leave_the_folder(client, page, name):
    assert put(client, name, text()).status_code in (404, 405, 422)
    assert not list(page.store.folder.parent.glob("*.json"))


def test_who_comes_from_elsewhere_is_turned_away(client):
    for headers in ({"host": "evil.example"}, {"origin": "http://evil.example"}, {"origin": "null"}, {"host": "127.0.0.1.evil.example"}):
        assert client.get("/api/scene", headers=headers).status_code == 403
    assert client.put("/api/skills/form", content=text(), headers={"content-type": "text/plain", "if-none-match": "*"}).status_code == 415
    assert put(client, "large", text(), **{"content-length": str(10**9)}).status_code == 413
    for headers in ({"origin": "http://evil.example"}, {"host": "evil.example"}):
        with pytest.raises(Exception), client.websocket_connect("/live?skill=x", headers=HERE | headers):
            pass


def test_another_host_needs_the_token(page):
    app = create(page, hosts=None, token="secret")
    stranger = TestClient(app, base_url="http://robot.lab:80")
    assert stranger.get("/").status_code == 403
    assert stranger.get("/?token=wrong").status_code == 403
    assert stranger.get("/?token=secret").status_code == 200
    assert stranger.get("/api/scene").status_code == 200  # by the cookie that came with the page


def test_a_viewpoint_is_rendered_and_kept_where_it_is_drawn_on(client, page):
    asked = {"camera": plain(VIEWS["view1"].resized(32, 24)), "tab": "t", "keep": 1}
    answer = client.post("/api/render", json=asked)
    assert answer.status_code == 200 and answer.headers["content-type"] == "image/jpeg"
    assert len(list((page.store.folder / ".pictures").iterdir())) == 1
    assert client.post("/api/render", json=asked).content == answer.content
    for change, field in (({"width": 10**9}, "camera.width"), ({"K": np.zeros((3, 3)).tolist()}, "camera.K"), ({"world_from_camera": np.ones((4, 4)).tolist()}, "camera")):
        refused = client.post("/api/render", json=asked | {"camera": asked["camera"] | change})
        assert refused.status_code == 422 and refused.json()["field"] == field


def test_what_is_off_says_so(client):
    put(client, "off", text())
    answer = client.post("/api/skills/off/fit", json={"tab": "t"})
    assert answer.status_code == 404 and "off" in answer.json()["error"]
    assert client.post("/api/skills/off/plan", json={"tab": "t"}).status_code == 409
    assert client.get("/api/skills/off/video").status_code == 404


def test_done_goes_on_only_with_a_motion_that_can_be_seen_in_3d(client, page):
    put(client, "flat", text(views=("view2",)))
    answer = client.post("/api/skills/flat/done", json={"tab": "t"})
    assert answer.status_code == 422 and "two views" in answer.json()["error"] and page.done == []
    put(client, "whole", text())
    assert client.post("/api/skills/whole/done", json={"tab": "t"}).json() == {"done": "whole"} and page.done == ["whole"]


ROUTES = ["/", "/static/{0}", "/pictures/{0}", "/api/scene", "/api/points", "/api/mesh", "/api/body", "/api/render", "/api/suggest", "/api/skills", "/api/skills/{0}",
          "/api/skills/{0}/fit", "/api/skills/{0}/plan", "/api/skills/{0}/perform", "/api/skills/{0}/video", "/api/skills/{0}/done", "/{0}"]  # fmt: skip
NAMES = st.one_of(st.text(alphabet=st.characters(exclude_characters="?#", exclude_categories=("Cs",)), max_size=30), st.sampled_from(["kept", "view1", "%00", "..%2f..", "%ff"]))
JSON = st.recursive(st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8), lambda x: st.lists(x, max_size=4) | st.dictionaries(st.text(max_size=8), x, max_size=4), max_leaves=12)


@st.composite
def nearly_right(draw):
    """A correct body with one place of it altered."""
    asked = {"camera": plain(VIEWS["view1"].resized(16, 12)), "tab": "t", "skill": "kept"}
    document = draw(st.sampled_from([json.loads(text(n=3)), asked, {"camera": asked["camera"], "tab": "t"}, {"tab": "t"}, {"skill": "kept", "tab": "t"}]))
    document = json.loads(json.dumps(document))
    place = document
    while isinstance(place, (dict, list)) and place:
        key = draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
        if not isinstance(place[key], (dict, list)) or draw(st.booleans()):
            place[key] = draw(JSON)
            break
        place = place[key]
    return json.dumps(document).encode()


BODIES = st.one_of(st.binary(max_size=40), JSON.map(lambda value: json.dumps(value).encode()), nearly_right())
HEADERS = st.fixed_dictionaries({}, optional={"content-type": st.sampled_from(["application/json", "text/plain"]), "if-match": st.sampled_from(['"x"', "", "*"]),
          "if-none-match": st.sampled_from(["*", "x"]), "host": st.sampled_from(["127.0.0.1", "x", "[", "a:b:c", ""]), "origin": st.sampled_from(["null", "http://[", "http://127.0.0.1:8765"]),
          "cookie": st.sampled_from(["a=b", ";;;", "=\x7f"]), "range": st.sampled_from(["bytes=0-3", "bytes=9-1", "x"])})  # fmt: skip


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.sampled_from(ROUTES), NAMES, st.sampled_from(["GET", "POST", "PUT", "DELETE", "HEAD", "PATCH"]), BODIES, HEADERS)
def test_nothing_that_is_sent_makes_the_server_fail(client, route, name, method, body, headers):
    json_by_default = {"content-type": "application/json", "if-none-match": "*"} if method != "GET" else {}
    answer = client.request(method, route.format(quote(name, safe='%/')), content=None if method in ("GET", "HEAD") else body, headers=json_by_default | headers)
    assert answer.status_code < 500
    if answer.status_code >= 400 and "range" not in headers and method != "HEAD" and not route.startswith("/static"):
        assert answer.json()["error"]
