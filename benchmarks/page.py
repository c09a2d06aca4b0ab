"""Load the page's opening scene again and again: how quick it is, and what blindness does.

Usage: renet page --out PAGE && python benchmarks/page.py PAGE [--loads 10]
"""

from __future__ import annotations

import argparse
import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from tests.evaluation.report.browser import Browser, find_browser

from renet.page.writer import make_server

AFTER = 10.0
"""Seconds from the fault to the look at the robots."""
PATIENCE = 180.0
LOOK = """(() => {
  const { page, stats } = renetPage;
  return { ...stats, now: page.now, upright: page.simulations.map((one) => one.upright),
    walking: page.simulations.map((one) => one.walking),
    speed: page.simulations.map((one) => one.speed) };
})()"""


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
        begun = browser.ask(LOOK)
        while browser.ask("renetPage.page.now") < onset + AFTER:
            time.sleep(0.05)
        seen = browser.ask(LOOK)
    finally:
        browser.close()
    seconds = seen["seconds"] - begun["seconds"]
    return {
        "first_s": seen["first"] / 1000,
        "real_time": (seen["simulated"] - begun["simulated"]) / seconds,
        "frame_ms": 1000 * seconds / (seen["pictures"] - begun["pictures"]),
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
    server = make_server(args.page, 0)
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
            f"{visit['frame_ms']:.0f} ms a picture; {', '.join(states)}; "
            f"load {os.getloadavg()[0]:.1f}",
            flush=True,
        )
    for key in ("first_s", "real_time", "frame_ms"):
        print(f"median {key}: {np.median([visit[key] for visit in visits]):.2f}")


if __name__ == "__main__":
    main()
