"""What two processes share is whole, or as it was before."""

import mmap

import numpy as np

from renet.deploy.robots.real.mailbox import (
    ALIVE_LAYOUT,
    COMMAND_LAYOUT,
    READING_LAYOUT,
    SIZE,
    mailboxes,
)


def test_a_value_is_read_whole_from_its_own_place_and_a_torn_one_is_none():
    memory, random = mmap.mmap(-1, SIZE), np.random.default_rng(1)
    boxes, values = mailboxes(memory), []
    assert [box.read() for box in boxes] == [None] * 3
    for number, (box, layout) in enumerate(
        zip(boxes, (ALIVE_LAYOUT, COMMAND_LAYOUT, READING_LAYOUT), strict=True)
    ):
        first, second = (np.frombuffer(random.bytes(layout.itemsize), layout)[0] for _ in "ab")
        box.write(first)
        assert box.read().tobytes() == first.tobytes()
        assert [box.read() for box in boxes[number + 1 :]] == [None] * (2 - number)
        box.write(second)
        for place in range(box.end - layout.itemsize - 4, box.end):
            memory[place] ^= 255
            assert box.read().tobytes() == first.tobytes()
            memory[place] ^= 255
        values.append(second.tobytes())
    assert [box.read().tobytes() for box in mailboxes(memory)] == values
