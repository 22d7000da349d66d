"""The queue that is emptied in batches: order, size, age, room, and being closed."""

from __future__ import annotations

import threading
import time

import pytest

from activelsd.train.actors.ga3c.queues import BatchQueue, ClosedError


def test_takes_what_waits_in_order_and_no_more_than_asked() -> None:
    queue: BatchQueue[int] = BatchQueue()
    for i in range(5):
        queue.put(i)
    assert queue.take(1, 3) == [0, 1, 2]
    assert queue.take(1, 3) == [3, 4]
    assert len(queue) == 0


def test_a_full_batch_goes_at_once_and_a_small_one_when_its_oldest_is_old() -> None:
    queue: BatchQueue[int] = BatchQueue()
    began = time.monotonic()
    queue.put(0)
    assert queue.take(1, 2, patience=0.2) == [0]
    assert 0.2 <= time.monotonic() - began < 30
    queue.put(1)
    threading.Timer(0.05, queue.put, [2]).start()
    began = time.monotonic()
    assert queue.take(1, 2, patience=60) == [1, 2]
    assert time.monotonic() - began < 30


def test_least_is_waited_for_however_old_the_oldest() -> None:
    queue: BatchQueue[int] = BatchQueue()
    queue.put(0)
    threading.Timer(0.1, queue.put, [1]).start()
    assert queue.take(2, 2) == [0, 1]


def test_put_waits_for_room_and_nothing_is_lost_between_threads() -> None:
    queue: BatchQueue[int] = BatchQueue(limit=3)
    taken: list[int] = []
    greatest = 0

    def put(start: int) -> None:
        for i in range(start, start + 100):
            queue.put(i)

    threads = [threading.Thread(target=put, args=(100 * n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    while len(taken) < 400:
        greatest = max(greatest, len(queue))
        taken += queue.take(1, 2)
    for thread in threads:
        thread.join()
    assert sorted(taken) == list(range(400))
    assert greatest <= 3


def test_closing_wakes_everyone() -> None:
    full: BatchQueue[int] = BatchQueue(limit=1)
    full.put(0)
    empty: BatchQueue[int] = BatchQueue()
    woken = []

    def wait(call: object, *arguments: object) -> None:
        with pytest.raises(ClosedError):
            call(*arguments)  # type: ignore[operator]
        woken.append(call)

    threads = [
        threading.Thread(target=wait, args=(full.put, 1)),
        threading.Thread(target=wait, args=(empty.take, 1, 1)),
        threading.Thread(target=wait, args=(empty.take, 1, 1)),
    ]
    for thread in threads:
        thread.start()
    time.sleep(0.05)
    full.close()
    empty.close()
    for thread in threads:
        thread.join(60)
    assert len(woken) == 3
