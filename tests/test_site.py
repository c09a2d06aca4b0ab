"""The documentation in a browser; RENET_SITE is the folder that sphinx-build wrote (.ci/run)."""

import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page

from tests.browser import compare, open_browser, watch

SITE = Path(os.environ.get("RENET_SITE", ""))
GOLDEN = Path(__file__).with_name("golden")
DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
SIZES = {"desktop": DESKTOP, "phone": PHONE}
PAGES = sorted(path.stem for path in (Path(__file__).parents[1] / "docs").glob("*.md"))
ACROSS = """[...document.querySelectorAll("article table, article pre, article img")]
  .filter((part) => part.getBoundingClientRect().right > innerWidth)
  .map((part) => part.outerHTML)"""
Scheme = Literal["light", "dark"]
pytestmark = pytest.mark.skipif("RENET_SITE" not in os.environ, reason="no site was built")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser() as browser:
        yield browser


def visit(
    browser: Browser,
    name: str,
    size: dict[str, int],
    scheme: Scheme = "light",
) -> Page:
    """A page whose pictures have all come, and that is no wider than its window."""
    page = browser.new_page(viewport=size, color_scheme=scheme)  # type: ignore[arg-type]
    complaints, _ = watch(page)
    page.goto((SITE / f"{name}.html").resolve().as_uri())
    page.wait_for_function("[...document.images].every((one) => one.complete)")
    assert page.evaluate("[...document.images].every((one) => one.naturalWidth > 0)")
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    # Read as a file, it cannot load the demo that is embedded in it.
    assert complaints == [] or name == "start"
    return page


@pytest.mark.parametrize("name", PAGES)
def test_nothing_of_a_page_lies_beyond_a_laptops_edge(browser: Browser, name: str) -> None:
    page = visit(browser, name, DESKTOP)
    assert page.evaluate(ACROSS) == []
    page.close()


@pytest.mark.parametrize("size", SIZES)
def test_the_first_page_begins_with_a_picture(browser: Browser, size: str) -> None:
    page = visit(browser, "index", SIZES[size])
    box = page.locator("article img").first.bounding_box()
    assert box is not None
    assert box["y"] + box["height"] < SIZES[size]["height"]
    assert box["width"] > 0.6 * min(SIZES[size]["width"], 800)
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_figures_are_as_dark_as_the_page(browser: Browser, scheme: Scheme) -> None:
    for name, file in (("memory", "memory.png"), ("how_it_works", "architecture.svg")):
        page = visit(browser, name, DESKTOP, scheme)
        picture = page.locator(f'article img[src$="{file}"]').screenshot()
        brightness = np.asarray(Image.open(io.BytesIO(picture)).convert("L")).mean()
        assert brightness > 200 if scheme == "light" else brightness < 70
        page.close()


@pytest.mark.parametrize("size", SIZES)
def test_how_it_works_looks_like_its_golden_picture(browser: Browser, size: str) -> None:
    page = visit(browser, "how_it_works", SIZES[size])
    compare(page.screenshot(), GOLDEN / f"how_it_works-{size}.png")
    page.close()
