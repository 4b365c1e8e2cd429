"""The skills of a scene on disk: sketches/<name>.json in its capture folder, the only state of the page.

A revision is a hash of the file's bytes. Who writes says which revision they saw, so that of two writers the second
is told instead of the first being lost. A file is replaced whole (scene.files), so a killed server leaves none broken.
"""

import hashlib
import os
import re
import time
import unicodedata
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock

from teach.sketch import Sketch, SketchError, loads

MAX_BODY = 32 * 2**20
"""Bytes of a skill."""
MAX_STROKES, MAX_TOTAL = 500, 500_000
"""Strokes and points of a skill."""
_NAME = re.compile(r"\w[\w .()-]*")


class Conflict(ValueError):
    """The skill is not what the writer saw; ``revision`` is what it is now, None if it is gone."""

    def __init__(self, message: str, revision: str | None):
        super().__init__(message)
        self.revision = revision


def checked_name(name: str) -> str:
    """The name of a skill: words, never a path. Raises SketchError."""
    name = unicodedata.normalize("NFC", name).strip()
    if not _NAME.fullmatch(name) or name.endswith(".") or len(name.encode()) > 100:
        raise SketchError(
            f"name is {name[:40]!r}: a skill's name has up to 100 bytes of letters, digits, spaces and . - _ ( ), a letter or digit first"
        )
    return name


def revision_of(body: bytes) -> str:
    return hashlib.sha256(body).hexdigest()[:20]


def parse(body: bytes) -> list[Sketch]:
    """The sketches of a skill's text. Raises SketchError naming the field that is wrong."""
    try:
        text = body.decode("utf-8")
    except UnicodeDecodeError as error:
        raise SketchError(f"not UTF-8 text ({error})") from None
    sketches = loads(text)
    names = [sketch.view for sketch in sketches]
    if len(set(names)) < len(names):
        raise SketchError("sketches: two of them have the same view; put all strokes of a view in one")
    strokes = [stroke for sketch in sketches for stroke in sketch.strokes]
    if len(strokes) > MAX_STROKES:
        raise SketchError(f"sketches: {len(strokes)} strokes; at most {MAX_STROKES} are allowed")
    if (points := sum(len(stroke.points) for stroke in strokes)) > MAX_TOTAL:
        raise SketchError(f"sketches: {points} points; at most {MAX_TOTAL} are allowed")
    return sketches


class Store:
    """The files of a folder, by the names of the skills."""

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)

    def names(self) -> list[dict]:
        """name and time of the last change [s] of each skill, newest first."""
        files = [(path.stem, path.stat().st_mtime) for path in self.folder.glob("*.json") if not path.name.startswith(".")]
        known = [{"name": name, "changed": changed} for name, changed in files if _NAME.fullmatch(name)]
        return sorted(known, key=lambda skill: -skill["changed"])

    def read(self, name: str) -> bytes:
        """The text of a skill. Raises FileNotFoundError."""
        try:
            return self._path(name).read_bytes()
        except OSError:
            raise FileNotFoundError(f"there is no skill called {name!r}") from None

    def write(self, name: str, body: bytes, seen: str | None) -> str:
        """Keep a skill whose text is checked; the revision that it has now. seen: the revision that the writer saw, None
        for a new skill. Raises Conflict, SketchError."""
        path = self._path(name)
        parse(body)
        with self._locked():
            self._require(name, seen)
            temporary = path.with_name(f".{os.getpid()}.{path.name}")
            with open(temporary, "wb") as file:
                file.write(body)
                file.flush()
                os.fsync(file.fileno())  # the page is told "saved": a power cut must not make it untrue
            os.replace(temporary, path)
        return revision_of(body)

    def remove(self, name: str, seen: str | None) -> None:
        """Put a skill aside into .removed/, from where a person can take it back. Raises Conflict, FileNotFoundError."""
        with self._locked():
            self._require(name, seen)
            aside = self.folder / ".removed"
            aside.mkdir(exist_ok=True)
            os.replace(self._path(name), aside / f"{name}.{time.time_ns()}.json")

    def _path(self, name: str) -> Path:
        return self.folder / f"{checked_name(name)}.json"

    @contextmanager
    def _locked(self):
        self.folder.mkdir(parents=True, exist_ok=True)
        with FileLock(self.folder / ".lock"):
            yield

    def _require(self, name: str, seen: str | None) -> None:
        try:
            now = revision_of(self.read(name))
        except FileNotFoundError:
            now = None
        if now != seen:
            raise Conflict(
                f"{name!r} was changed elsewhere since this page saw it" if now else f"{name!r} is not there any more", now
            )
