"""This machine's headless Chromium, driven by Playwright; no browser is downloaded."""

import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
OPTIONS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--enable-unsafe-swiftshader",
    # WebAssembly does not run for long enough here to be worth optimising.
    "--js-flags=--liftoff-only",
)
PATIENCE = 120.0
"""Seconds for which a busy machine may keep a test waiting."""
SMALLER, COARSER = 8, 4
"""Pixels of a screenshot for each of a golden picture, and of that for each block compared."""
APART, WORST = 8.0, 60.0
"""Mean and largest difference from a golden picture, of 255."""


@contextmanager
def open_browser() -> Iterator[Browser]:
    """A browser; skips the test where there is none."""
    program = next((path for name in NAMES if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium on this machine: install chromium-headless-shell")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=OPTIONS)
        yield browser
        browser.close()


def watch(page: Page) -> tuple[list[str], list[str]]:
    """What the console will complain of, and the addresses that will be asked for."""
    complaints, requests = [], []
    # Chromium notes how slowly it draws without a GPU.
    said = lambda m: m.type != "error" or complaints.append(m.text)  # noqa: E731
    page.on("console", said)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.set_default_timeout(1000 * PATIENCE)
    return complaints, requests


def compare(screenshot: bytes, golden: Path, worst: float = WORST) -> None:
    """Fail where a screenshot is blank, or looks otherwise than a small golden picture.

    To make that anew, delete it, run the test, and look at what it wrote.
    """
    shot = Image.open(io.BytesIO(screenshot)).convert("RGB")
    size = shot.width // SMALLER, shot.height // SMALLER
    small = shot.resize(size, Image.Resampling.BOX)
    assert np.asarray(small, float).std() > 10, "blank"
    if not golden.exists():
        small.save(golden)
        pytest.fail(f"{golden} is new: look at it")
    expected = np.asarray(Image.open(golden), float)
    difference = np.abs(np.asarray(small, float) - expected).mean(axis=2)
    assert difference.mean() < APART
    rows, columns = (side // COARSER for side in difference.shape)
    whole = difference[: COARSER * rows, : COARSER * columns]
    blocks = whole.reshape(rows, COARSER, columns, COARSER).mean(axis=(1, 3))
    assert blocks.max() < worst, np.unravel_index(blocks.argmax(), blocks.shape)
