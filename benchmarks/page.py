"""Load the page's opening scene again and again: how quick it is, and what blindness does.

Usage: renet page --out PAGE && python -m benchmarks.page PAGE [--scene '?ground=gap'] [--loads 10]
       [--json FILE]

"Page" is the processor time of the renderer process (JavaScript and WebAssembly), "drawing" that of
the process that stands for the GPU. On a busy machine they say more than the clock does.
"""

from __future__ import annotations

import argparse
import os
import re
import threading
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.facts import errors_in_one_line, report
from playwright.sync_api import Browser
from tests.browser import open_browser

from renet.server import serve_folder

AFTER = 6.0
"""Seconds from the fault to the look at the robots, before the show is played again."""
PATIENCE = 500.0
TICKS = os.sysconf("SC_CLK_TCK")
LOOK = """(() => {
  const { page, stats } = renetPage;
  const end = ({ fell, done }) => (fell !== null ? "fell" : done !== null ? "crossed" : "walks");
  return { ...stats, ends: page.story.tales.map(end), sentence: page.story.sentence };
})()"""
MEASURED = ("first_s", "ready_s", "real_time", "frame_ms", "cpu_page", "cpu_drawing")
"""Numbers of a visit whose medians are told."""


def processor_time(root: int) -> dict[str, float]:
    """CPU seconds that a process's descendants have taken so far, by kind, of /proc (Linux)."""
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


def load(browser: Browser, address: str) -> dict[str, Any]:
    """One visit that touches nothing, until `AFTER` seconds after the fault."""
    page = browser.new_page(viewport={"width": 1400, "height": 800})
    page.set_default_timeout(1000 * PATIENCE)
    page.goto(address)
    page.wait_for_function("Boolean(globalThis.renetPage?.stats.ready)", polling=50)
    begun, spent = page.evaluate(LOOK), processor_time(os.getpid())
    page.wait_for_function("renetPage.page.story.onset !== null", polling=50)
    onset = page.evaluate("renetPage.page.story.onset")
    page.wait_for_function(f"renetPage.page.now >= {onset + AFTER}", polling=50)
    seen, total = page.evaluate(LOOK), processor_time(os.getpid())
    page.close()
    simulated, seconds, pictures = (
        seen[key] - begun[key] for key in ("simulated", "seconds", "pictures")
    )
    took = {kind: 1000 * (total[kind] - spent.get(kind, 0.0)) for kind in total}
    return {
        "first_s": seen["first"] / 1000,
        "ready_s": seen["ready"] / 1000,
        "real_time": simulated / seconds,
        "frame_ms": 1000 * seconds / pictures,
        "cpu_page": took["renderer"] / simulated,
        "cpu_drawing": took.get("gpu-process", 0.0) / pictures,
        "ends": seen["ends"],
        "sentence": seen["sentence"],
    }


def main() -> None:
    """Print one line a visit, and the medians; with --json, keep them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path)
    parser.add_argument("--scene", default="", help="query of the address: ?ground=gap")
    parser.add_argument("--loads", type=int, default=10)
    parser.add_argument("--json", type=Path, help="file for the results")
    args = parser.parse_args()
    server = serve_folder(args.page, 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    visits = []
    with open_browser() as browser:
        for _ in range(args.loads):
            visit = load(browser, f"http://127.0.0.1:{server.server_port}/{args.scene}")
            visits.append(visit)
            print(
                f"first picture {visit['first_s']:.1f} s, walks after {visit['ready_s']:.1f} s, "
                f"real-time factor {visit['real_time']:.2f}, {visit['frame_ms']:.0f} ms a picture; "
                f"processor time: page {visit['cpu_page']:.0f} ms a simulated second, drawing "
                f"{visit['cpu_drawing']:.0f} ms a picture; load {os.getloadavg()[0]:.1f}; "
                f"{visit['sentence']}",
                flush=True,
            )
    medians = {f"median_{key}": float(np.median([one[key] for one in visits])) for key in MEASURED}
    ends = [visit["ends"] for visit in visits]
    results = {
        "loads": args.loads,
        "left_fell": sum(left == "fell" for left, _ in ends),
        "right_crossed": sum(right == "crossed" for _, right in ends),
        "left_fell_and_right_crossed": ends.count(["fell", "crossed"]),
    }
    report(results | medians | {"visits": visits}, args.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main()
