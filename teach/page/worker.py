"""Long work in a process of its own, warm between two requests; a newer request takes the place of an older one.

    worker = Worker(make)                       # make() -> {"fit": function(progress, *arguments)}, called in the process
    await worker.do("tab 7", "fit", text)       # Superseded if "tab 7" asks for something newer; Refused for bad input

``progress(share, words)`` tells how far the work is. Work that nobody waits for any more is interrupted as Ctrl-C would do
it, by a signal, wherever it is in Python; what does not stop within ``patience`` is ended with its process, and the next
one starts a fresh process.
"""

import asyncio
import logging
import multiprocessing
import os
import signal
import traceback

log = logging.getLogger("scene2skill")


class Superseded(Exception):
    """A newer request took the place of this one, or whoever asked is gone."""


class Refused(ValueError):
    """The work cannot be done with this input; the message says why."""


class _Stopped(BaseException):
    """Raised by the signal; no ``except Exception`` of the work keeps it."""


class Worker:
    """One process that does one piece of work at a time. patience: [s]."""

    def __init__(self, make, patience: float = 5.0):
        self.make, self.patience = make, patience
        self._waiting: dict[str, asyncio.Event] = {}
        self._turn = asyncio.Lock()
        self._process = None

    def start(self) -> None:
        """Begin to load what the work needs, so that the first request finds it warm."""
        if self._process is not None and self._process.is_alive():
            return
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(self.make, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self._ready = self._sent = False

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None

    async def do(self, key: str, name: str, *arguments, told=None, dropped: asyncio.Event | None = None):
        """What the function ``name`` returns. key: whose request this is; told(share, words) hears of progress; dropped is set
        when nobody waits for this one any more."""
        if key in self._waiting:
            self._waiting[key].set()
        self._waiting[key] = dropped = dropped or asyncio.Event()
        try:
            async with self._turn:
                if dropped.is_set():
                    raise Superseded
                return await self._run(dropped, name, arguments, told or (lambda share, words: None))
        finally:
            if self._waiting.get(key) is dropped:
                del self._waiting[key]

    async def _run(self, dropped, name, arguments, told):
        self.start()
        self._sent = False
        answer = asyncio.ensure_future(self._answer(name, arguments, told))
        gone = asyncio.ensure_future(dropped.wait())
        try:
            await asyncio.wait((answer, gone), return_when=asyncio.FIRST_COMPLETED)
            if not answer.done() and self._sent:
                os.kill(self._process.pid, signal.SIGUSR1)
                await asyncio.wait((answer,), timeout=self.patience)
            if dropped.is_set():
                raise Superseded
            return answer.result()
        finally:
            gone.cancel()
            if answer.done():
                answer.exception()  # seen, also where nobody waits for it
            else:
                answer.cancel()
                await asyncio.wait((answer,))
                if self._sent:
                    self.close()

    async def _answer(self, name, arguments, told):
        if not self._ready:  # it is still loading, and could not be interrupted
            await self._received()
            self._ready = True
        self._pipe.send((name, arguments))
        self._sent = True
        while True:
            kind, value = await self._received()
            if kind == "progress":
                told(*value)
            elif kind == "done":
                return value
            elif kind == "stopped":
                raise Superseded
            else:
                raise Refused(value)

    async def _received(self):
        arrived, loop, pipe = asyncio.Event(), asyncio.get_running_loop(), self._pipe.fileno()
        loop.add_reader(pipe, arrived.set)
        try:
            await arrived.wait()
            return self._pipe.recv()
        except (EOFError, ConnectionError):
            self.close()
            raise Refused("the process that worked on it ended; try again") from None
        finally:
            loop.remove_reader(pipe)


def _serve(make, pipe) -> None:
    """The process: answers until the pipe closes, which it does when the server ends in whatever way."""
    working = False

    def stop(*_):
        nonlocal working
        if working:
            working = False
            raise _Stopped

    def progress(share: float, words: str) -> None:
        nonlocal working
        working = False  # what is sent is sent whole
        pipe.send(("progress", (share, words)))
        working = True

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server
    signal.signal(signal.SIGUSR1, stop)
    functions = make()
    answer = "ready"
    while True:
        try:
            pipe.send(answer)
            name, arguments = pipe.recv()
            try:
                working = True
                answer = "done", functions[name](progress, *arguments)
            finally:
                working = False
        except (EOFError, ConnectionError):
            return
        except _Stopped:
            answer = "stopped", None
        except (ValueError, OSError) as error:
            answer = "refused", " ".join(str(error).split())
        except Exception as error:  # a defect: the page says so, the log says where
            traceback.print_exc()
            answer = "failed", f"{type(error).__name__}: {' '.join(str(error).split())}"
