"""A DDS domain that no other test, process or user of this computer is in."""

import fcntl
import os
import tempfile
from functools import cache

import pytest


@cache
def free_domain() -> int:
    """The domain of this process' tests, for as long as it lives; real robots are in 0."""
    for domain in range(1, 100):
        path = os.path.join(tempfile.gettempdir(), f"renet-test-dds-{domain}")
        lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW)  # Until the process ends.
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
        else:
            return domain
    pytest.fail("no free DDS domain")
