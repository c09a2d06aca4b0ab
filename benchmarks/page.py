"""Load the page's opening scene again and again: how quick it is, and what blindness does.

Usage: renet page --out PAGE && python -m benchmarks.page PAGE [--loads 10]

"Page" is the processor time of the renderer process (JavaScript and WebAssembly), "drawing" that of
the process that stands for the GPU. On a busy machine they say more than the clock does.
"""

from __future__ import annotations

import argparse
import os
import re
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from tests.evaluation.report.browser import Browser, find_browser

from renet.server import serve_folder

AFTER = 10.0
"""Seconds from the fault to the look at the robots."""
PATIENCE = 500.0
TICKS = os.sysconf("SC_CLK_TCK")
LOOK = """(() => {
  const { page, stats } = renetPage;
  return { ...stats, now: page.now, upright: page.simulations.map((one) => one.upright),
    walking: page.simulations.map((one) => one.walking),
    speed: page.simulations.map((one) => one.speed) };
})()"""


def processor_time(root: int) -> dict[str, float]:
    """CPU seconds that a browser's processes have taken so far, by kind, of /proc (Linux)."""
    parents, times = {}, {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            command = (folder / "cmdline").read_text()
        except OSError:
            continue
        kind = (re.findall(r"--type=([\w-]+)", command) or ["browser"])[0]
        parents[int(folder.name)] = int(fields[1])
        times[int(folder.name)] = kind, (int(fields[11]) + int(fields[12])) / TICKS
    total: dict[str, float] = {}
    for process, (kind, seconds) in times.items():
        ancestor = process
        while ancestor not in (root, 0):
            ancestor = parents.get(ancestor, 0)
        if ancestor == root:
            total[kind] = total.get(kind, 0.0) + seconds
    return total


def load(program: str, address: str) -> dict[str, Any]:
    """One visit that touches nothing, until `AFTER` seconds after the fault."""
    browser = Browser(program, PATIENCE)
    try:
        browser.open(address, 1400, dark=False)
        while not browser.ask("Boolean(globalThis.renetPage?.stats.first)"):
            time.sleep(0.1)
        broken = "renetPage.page.simulations[0].camera.fault?.onset ?? null"
        while (onset := browser.ask(broken)) is None:
            time.sleep(0.1)
        begun, spent = browser.ask(LOOK), processor_time(browser.process.pid)
        while browser.ask("renetPage.page.now") < onset + AFTER:
            time.sleep(0.05)
        seen, total = browser.ask(LOOK), processor_time(browser.process.pid)
    finally:
        browser.close()
    simulated, seconds, pictures = (
        seen[key] - begun[key] for key in ("simulated", "seconds", "pictures")
    )
    took = {kind: 1000 * (total[kind] - spent.get(kind, 0.0)) for kind in total}
    return {
        "first_s": seen["first"] / 1000,
        "real_time": simulated / seconds,
        "frame_ms": 1000 * seconds / pictures,
        "cpu_page": took["renderer"] / simulated,
        "cpu_drawing": took.get("gpu-process", 0.0) / pictures,
        **{key: seen[key] for key in ("upright", "walking", "speed")},
    }


def main() -> None:
    """Print one line a visit, and the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path)
    parser.add_argument("--loads", type=int, default=10)
    args = parser.parse_args()
    program = find_browser()
    if program is None:
        raise SystemExit("no Chromium on this machine")
    server = serve_folder(args.page, 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    visits = []
    for _ in range(args.loads):
        visit = load(program, f"http://127.0.0.1:{server.server_port}/")
        visits.append(visit)
        states = [
            f"{name} {'up' if up and walks else 'down'} {speed:.2f} m/s"
            for name, up, walks, speed in zip(
                ("VP", "RENet"), visit["upright"], visit["walking"], visit["speed"], strict=True
            )
        ]
        print(
            f"first picture {visit['first_s']:.1f} s, real-time factor {visit['real_time']:.2f}, "
            f"{visit['frame_ms']:.0f} ms a picture; processor time: page "
            f"{visit['cpu_page']:.0f} ms a simulated second, drawing "
            f"{visit['cpu_drawing']:.0f} ms a picture; "
            f"{', '.join(states)}; "
            f"load {os.getloadavg()[0]:.1f}",
            flush=True,
        )
    for key in ("first_s", "real_time", "frame_ms", "cpu_page", "cpu_drawing"):
        print(f"median {key}: {np.median([visit[key] for visit in visits]):.2f}")


if __name__ == "__main__":
    main()
