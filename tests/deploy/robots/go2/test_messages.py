"""The checksum of the Go2's messages against a bitwise CRC."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="needs renet-locomotion[go2]")

from renet.deploy.robots.go2.messages import LowCmd, LowState, crc


def bitwise(words: np.ndarray) -> int:
    """CRC-32 as a textbook has it: one bit after the other, polynomial 04C11DB7, start FFFFFFFF."""
    value = 0xFFFFFFFF
    for word in words.tolist():
        for bit in range(31, -1, -1):
            high = value >> 31 ^ word >> bit & 1
            value = (value << 1) & 0xFFFFFFFF ^ (0x04C11DB7 if high else 0)
    return value


@pytest.mark.parametrize("message", [LowCmd, LowState])
@pytest.mark.parametrize("seed", range(5))
def test_crc_is_that_of_a_bitwise_loop_over_all_words_but_the_last(message, seed):
    sample = message()
    sample.raw[:] = np.random.default_rng(seed).integers(0, 256, sample.raw.size)
    expected = bitwise(sample.raw.view("<u4")[:-1])
    assert crc(sample.raw) == expected
    sample.raw[-4:] = 7
    assert crc(sample.raw) == expected
    sample.raw[30] ^= 16
    assert crc(sample.raw) != expected
