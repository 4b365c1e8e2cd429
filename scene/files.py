"""Files are written whole or not at all: a killed job leaves no half file. What is read says what is
wrong with it."""

import json
import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from zipfile import BadZipFile


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary path beside ``path``, with its ending, to write to; moved into place at the end, removed if anything goes wrong."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read_json(path: Path, missing: str):
    """What a JSON file holds. Raises FileNotFoundError saying ``missing`` where there is none, ValueError if it is not JSON."""
    if not path.is_file():
        raise FileNotFoundError(missing)
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is not JSON: {error}") from error


def read_yaml(path, missing: str):
    """What a YAML file (a path, or a package's resource) holds, as ``read_json`` of JSON."""
    import yaml

    if not path.is_file():
        raise FileNotFoundError(missing)
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is not YAML: {error}") from None


def parse_npz(path: str | Path, what: str, writer: str, parse: Callable):
    """parse({name: array} of an npz file). Raises FileNotFoundError, or ValueError that says what it is not, why, and what
    writes one, such as ("a plan file", "robot.plan")."""
    import numpy as np

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no {path}: {writer} writes {what}")
    try:
        with np.load(path, allow_pickle=False) as file:
            return parse({name: file[name] for name in file.files})
    except (ValueError, KeyError, TypeError, EOFError, OSError, BadZipFile, zlib.error) as error:
        missing = "missing " * isinstance(error, KeyError)
        raise ValueError(f"{path} is not {what} ({missing}{error}); {writer} writes one") from None


def parse_json(path: str | Path, what: str, parse: Callable):
    """parse(what a JSON file holds). Raises FileNotFoundError, or ValueError naming the file and what parse misses in it or
    finds wrong."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such {what}: {path}")
    try:
        return parse(json.loads(path.read_text(encoding="utf-8")))
    except KeyError as error:
        raise ValueError(f"{path}: missing {error.args[0]}") from error
    except (TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
