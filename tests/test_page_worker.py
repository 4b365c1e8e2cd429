"""Long work in another process: warm, one at a time, given up for a newer request, never the end of the server."""

import asyncio
import os
import time

import pytest

from teach.page.worker import Refused, Superseded, Worker


def make():
    return {"double": double, "wait": wait, "pid": pid, "refuse": refuse, "break": fail, "die": die, "stubborn": stubborn}


def double(progress, x):
    progress(0.5, "half")
    return 2 * x


def wait(progress, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.01)
    return "waited"


def stubborn(progress):
    while True:
        try:
            time.sleep(10)
        except BaseException:
            pass


def pid(progress):
    return os.getpid()


def refuse(progress):
    raise ValueError("not with this")


def fail(progress):
    raise RuntimeError("a defect")


def die(progress):
    os._exit(1)


@pytest.fixture(scope="module")
def worker():
    worker = Worker(make, patience=0.3)
    yield worker
    worker.close()


LOOP = asyncio.new_event_loop()  # a worker belongs to one
run = LOOP.run_until_complete


def test_it_answers_and_tells_how_far_it_is(worker):
    heard = []
    assert run(worker.do("tab", "double", 21, told=lambda *words: heard.append(words))) == 42
    assert heard == [(0.5, "half")]


def test_the_process_stays_warm_after_errors(worker):
    async def ask():
        first = await worker.do("tab", "pid")
        for name, said in (("refuse", "not with this"), ("break", "RuntimeError: a defect")):
            with pytest.raises(Refused, match=said):
                await worker.do("tab", name)
        return first, await worker.do("tab", "pid")

    first, then = run(ask())
    assert first == then != os.getpid()


def test_a_newer_request_takes_the_place_of_an_older_one_at_once_and_the_process_stays_warm(worker):
    async def ask():
        first = await worker.do("tab", "pid")
        older = asyncio.create_task(worker.do("tab", "wait", 60))
        await asyncio.sleep(0.1)
        started = time.monotonic()
        then = await worker.do("tab", "pid")
        with pytest.raises(Superseded):
            await older
        return first == then, time.monotonic() - started

    same, took = run(ask())
    assert same and took < 5


def test_others_wait_for_their_turn_and_get_their_own_answers(worker):
    async def ask():
        return await asyncio.gather(*(worker.do(f"tab {i}", "double", i) for i in range(20)))

    assert run(ask()) == [2 * i for i in range(20)]


def test_what_does_not_stop_is_ended_and_the_next_request_finds_a_fresh_process(worker):
    async def ask():
        gone = asyncio.Event()
        older = asyncio.create_task(worker.do("tab", "stubborn", dropped=gone))
        await asyncio.sleep(0.3)
        gone.set()
        with pytest.raises(Superseded):
            await older
        return await worker.do("tab", "double", 1)

    assert run(ask()) == 2


def test_a_process_that_dies_is_replaced(worker):
    async def ask():
        with pytest.raises(Refused, match="ended"):
            await worker.do("tab", "die")
        return await worker.do("tab", "double", 1)

    assert run(ask()) == 2


def slow_make():
    time.sleep(1.0)
    return {"pid": pid}


def test_a_request_given_up_while_the_process_loads_does_not_end_it():
    worker = Worker(slow_make)

    async def ask():
        older = asyncio.create_task(worker.do("tab", "pid"))
        await asyncio.sleep(0.2)
        started = worker._process.pid
        answer = await worker.do("tab", "pid")
        with pytest.raises(Superseded):
            await older
        return started == answer

    try:
        assert asyncio.run(ask())
    finally:
        worker.close()
