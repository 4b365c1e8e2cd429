"""Skills on disk: nothing is lost, mixed or half written, and a name is never a path."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scene.camera import Camera, look_at
from teach.page import store as stores
from teach.page.store import Conflict, Store, checked_name, parse
from teach.sketch import Sketch, SketchError, Stroke, dumps, loads

ROOT = Path(__file__).parents[1]
CAMERA = Camera.from_fov(look_at([1.0, 0.5, 1.0], [0, 0, 0]), 64, 48, 50)


def text(*lengths, view="view1") -> bytes:
    strokes = [Stroke(np.random.default_rng(n).uniform(0, 48, (n, 2)), np.arange(n) / 240) for n in lengths]
    return dumps([Sketch(view, CAMERA, strokes)]).encode()


def test_what_is_written_is_read_to_the_byte(tmp_path):
    store = Store(tmp_path / "sketches")
    store.write("reach", text(5, 9), None)
    assert store.read("reach") == text(5, 9)
    assert len(loads(store.read("reach"))[0].strokes) == 2
    assert [skill["name"] for skill in store.names()] == ["reach"]


def test_the_second_of_two_writers_is_told_and_nothing_is_lost(tmp_path):
    store = Store(tmp_path)
    first = store.write("reach", text(5), None)
    second = store.write("reach", text(6), first)
    with pytest.raises(Conflict) as conflict:
        store.write("reach", text(7), first)
    assert conflict.value.revision == second and store.read("reach") == text(6)


def test_a_new_skill_does_not_replace_one_of_its_name(tmp_path):
    store = Store(tmp_path)
    store.write("reach", text(5), None)
    with pytest.raises(Conflict):
        store.write("reach", text(6), None)


def test_a_removed_skill_is_put_aside_not_destroyed(tmp_path):
    store = Store(tmp_path)
    store.remove("reach", store.write("reach", text(5), None))
    assert store.names() == []
    assert [path.read_bytes() for path in (tmp_path / ".removed").iterdir()] == [text(5)]


@pytest.mark.parametrize("name", ["../reach", "a/b", "/etc/passwd", ".hidden", "", " ", "a\0b", "a\nb", "a\\b", "x" * 101, "reach."])
def test_a_name_is_never_a_path(tmp_path, name):
    store = Store(tmp_path / "sketches")
    with pytest.raises(SketchError, match="name"):
        store.write(name, text(5), None)
    assert not (tmp_path / "sketches").exists()


@given(st.text(max_size=120))
def test_any_name_is_refused_or_a_file_of_the_folder(name):
    try:
        name = checked_name(name)
    except SketchError:
        return
    assert os.path.basename(name) == name and not name.startswith(".") and len(f".1234567.{name}.json".encode()) < 255


@given(st.binary(max_size=80))
def test_any_bytes_are_refused_with_a_sentence(body):
    with pytest.raises(SketchError):
        parse(body)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda d: d["sketches"][0]["strokes"][0].update(times=[0.0, float("nan")]), r"sketches\[0\].strokes\[0\].times"),
        (lambda d: d["sketches"][0].update(view=7), r"sketches\[0\].view"),
        (lambda d: d["sketches"].append(d["sketches"][0]), "sketches: two of them"),
        (lambda d: d.update(version=2), "version"),
        (lambda d: d["sketches"][0]["camera"].update(K=[[0] * 3] * 3), "view1"),
    ],
)
def test_an_error_names_the_field(change, field):
    document = json.loads(text(2))
    change(document)
    with pytest.raises(SketchError, match=field):
        parse(json.dumps(document).encode())


def test_strokes_and_points_are_limited(monkeypatch):
    monkeypatch.setattr(stores, "MAX_STROKES", 3)
    monkeypatch.setattr(stores, "MAX_TOTAL", 20)
    parse(text(5, 5, 5))
    with pytest.raises(SketchError, match="4 strokes"):
        parse(text(2, 2, 2, 2))
    with pytest.raises(SketchError, match="21 points"):
        parse(text(21))


WRITER = """
import sys
from teach.page.store import Store
from tests.test_page_store import text
store, seen, n = Store(sys.argv[1]), None, 2
while True:
    seen = store.write("reach", text(*range(2, n + 1)), seen)
    print(n, flush=True)
    n = n % 40 + 1 if n < 40 else 2
"""


def test_a_writer_killed_at_any_moment_leaves_a_whole_file_with_all_that_it_was_told_is_saved(tmp_path):
    rng = np.random.default_rng(0)
    for attempt in range(6):
        folder = tmp_path / str(attempt)
        writer = subprocess.Popen([sys.executable, "-c", WRITER, folder], stdout=subprocess.PIPE, text=True, cwd=ROOT)
        said = int(writer.stdout.readline())
        time.sleep(rng.uniform(0, 0.1))
        writer.send_signal(signal.SIGKILL)
        said = [said, *map(int, writer.stdout.read().split())][-1]
        writer.wait()
        strokes = len(parse(Store(folder).read("reach"))[0].strokes)
        assert strokes in (said - 1, said if said < 40 else 1)
        Store(folder).write("again", text(3), None)  # a lock held by the dead is free
