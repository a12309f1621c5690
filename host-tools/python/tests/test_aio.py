"""Tests of the asyncio client against a virtual finger."""

import asyncio

import pytest
from fingers import serve

from taxel import AsyncFinger, Finger, LinkError


def test_frames_are_awaited_without_loss(command: str):
    async def program(port: str) -> list[int]:
        beats = 0

        async def heart() -> None:
            nonlocal beats
            while True:
                await asyncio.sleep(0.01)
                beats += 1

        async with AsyncFinger(port) as finger:
            heart_beats = asyncio.create_task(heart())
            assert await finger.ask(Finger.set_rate, 500) == 500
            seqs = [frame.seq async for frame in finger.frames(seconds=1)]
            heart_beats.cancel()
            assert finger.counts.lost == finger.counts.overflow == 0
        # The event loop ran other tasks meanwhile.
        assert beats > 20
        return seqs

    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port:
        seqs = asyncio.run(program(port))
    assert len(seqs) == pytest.approx(500, abs=1)
    assert {b - a for a, b in zip(seqs, seqs[1:], strict=False)} == {1}


def test_latest_is_awaited_and_two_fingers_run_at_once(command: str):
    async def newest(port: str) -> float:
        async with AsyncFinger(port) as finger:
            ages = []
            for _ in range(20):
                ages.append((await finger.latest(max_age_s=2)).age_s)
                await asyncio.sleep(0.01)
            return max(ages)

    async def both(*ports: str) -> list[float]:
        return await asyncio.gather(*map(newest, ports))

    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as one:
        with serve(command, "sim:press", "--tcp", "127.0.0.1:0") as other:
            assert max(asyncio.run(both(one, other))) < 2


def test_finger_that_goes_ends_the_loop_with_an_error(command: str):
    async def program() -> None:
        with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port:
            finger = await AsyncFinger(port).__aenter__()
            frames = finger.frames()
            await anext(frames)
        async for _ in frames:
            pass

    with pytest.raises(LinkError, match="closed the link|reset by peer"):
        asyncio.run(program())
