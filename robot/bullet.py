"""PyBullet without its greetings: it prints one when it is imported and one at each connection, in the middle of whatever runs."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def _quiet() -> Iterator[None]:
    """What C code writes to the standard streams meanwhile goes nowhere."""
    sys.stdout.flush()
    sys.stderr.flush()
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    kept = [os.dup(1), os.dup(2)]
    with open(os.devnull, "wb") as nowhere:
        for stream in (1, 2):
            os.dup2(nowhere.fileno(), stream)
        try:
            yield
        finally:
            libc.fflush(None)
            for stream, copy in zip((1, 2), kept):
                os.dup2(copy, stream)
                os.close(copy)


with _quiet():
    import pybullet
    from pybullet_utils.bullet_client import BulletClient


def connect() -> BulletClient:
    """A headless client of its own."""
    with _quiet():
        return BulletClient(pybullet.DIRECT)


__all__ = ["BulletClient", "connect", "pybullet"]
