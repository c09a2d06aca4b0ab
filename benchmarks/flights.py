"""Runs of `renet deploy` that write to one folder and are ended in every way, for the soak."""

import hashlib
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np

from renet.deploy.recording.reader import read_recording
from renet.errors import RenetError

COMMAND = ("-m", "renet.cli", "deploy", "--terrain", "obstacles", "--seconds", "30", "--out")
ON_A_SMALL_DISK = """mount -t tmpfs -o size=${1}k none $2; disk=$2; shift 2
"$@"; code=$?; cp -r $disk/. $disk-copy; exit $code"""
"""Runs a command with a disk of $1 kB at $2, and keeps a copy of what that held."""
SIGNALS = ("KILL", "TERM", "INT")
WHOLE, FULL = "nothing", "full disk"
EVERY = 60.0
"""Seconds from one start to the next."""
PATIENCE = 300.0
"""Seconds after which a run hangs; one takes up to a minute where others keep the computer busy."""
WITHOUT_HEADER = 1000
"""Bytes of a recording so young that a KILL may leave nothing to read."""


class Flights(threading.Thread):
    """Starts a run a minute, ends it, and looks at what it left."""

    def __init__(self, out: Path, seed: int) -> None:
        super().__init__(daemon=True)
        self.count: Counter[str] = Counter()
        """What happened, and how often."""
        self._out, self._random, self._over = out, np.random.default_rng(seed), threading.Event()

    def run(self) -> None:
        """Run until `stop`; the first shows how long a run takes and how much it writes."""
        begun = time.monotonic()
        self._fly(WHOLE, PATIENCE)
        seconds = time.monotonic() - begun
        size = max(path.stat().st_size for path in self._recordings().values())
        while not self._over.wait(max(0.0, begun + EVERY - time.monotonic())):
            begun, end = time.monotonic(), str(self._random.choice((*SIGNALS, FULL, WHOLE)))
            if end == FULL:
                self._fly(end, PATIENCE, int(self._random.integers(4, size // 1000)))
            else:
                wait = self._random.uniform(0.0, seconds) if end in SIGNALS else PATIENCE
                self._fly(end, wait)

    def stop(self) -> None:
        """End after the present run."""
        self._over.set()
        if self.is_alive():
            self.join()

    def _fly(self, end: str, wait: float, room: int | None = None) -> None:
        """One run, its end after `wait` seconds, and what it left; `room`: kB of a disk."""
        before, out, small = self._recordings(), self._out, []
        if room is not None:
            out = self._out / f"disk-{sum(self.count.values())}"
            out.mkdir()
            small = ["unshare", "-rm", "sh", "-c", ON_A_SMALL_DISK, "sh", str(room), str(out)]
        command = [*small, sys.executable, *COMMAND, str(out)]
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        with suppress(subprocess.TimeoutExpired):
            process.wait(wait)
        if end in SIGNALS:
            process.send_signal(signal.Signals[f"SIG{end}"])
        try:
            messages = process.communicate(timeout=PATIENCE)[1]
        except subprocess.TimeoutExpired:
            self.count["hung"] += 1
            process.kill()
            messages = process.communicate()[1]
        after = self._recordings()
        self.count[f"ended by {end}, exit code {process.returncode}"] += 1
        if "Traceback" in messages:
            self.count[f"a traceback: {messages.splitlines()[-1][:100]}"] += 1
        self.count["earlier recordings that changed"] += len(before.keys() - after.keys())
        for path in (after[content] for content in after.keys() - before.keys()):
            self.count["recordings"] += 1
            try:
                self.count["torn recordings"] += not read_recording(path).complete
            except RenetError:
                self.count["unreadable recordings"] += path.stat().st_size >= WITHOUT_HEADER

    def _recordings(self) -> dict[str, Path]:
        """All recordings by a hash of their content."""
        files = self._out.rglob("recording.mcap")
        return {hashlib.sha256(file.read_bytes()).hexdigest(): file for file in files}
