"""A visitor of the page in a real browser."""

from itertools import combinations

from tests.browser import watch

DESKTOP = {"width": 1280, "height": 760}
PHONE = {"width": 390, "height": 844}
PARTS = (
    "h1",
    "nav > *",
    ".outcome",
    ".who select",
    ".eye",
    "#faults",
    ".bar",
    ".drive",
    "#go",
    "#turn",
)
"""What is laid over the stage, and must not lie upon each other."""
NEWS = ("#message", "#verdict", ".state span:not(:empty)")
"""What comes and goes there."""
BOXES = """parts => {
  const boxes = {};
  for (const part of parts) {
    const visible = [...document.querySelectorAll(part)].filter(e => e.checkVisibility());
    visible.forEach((element, number) => {
      boxes[`${part} ${number}`] = element.getBoundingClientRect().toJSON();
    });
  }
  return boxes;
}"""
"""Function of the page: places of the visible elements of each selector, px."""
QUICK = """{ const { page } = renetPage;
  const { get } = Object.getOwnPropertyDescriptor(Object.getPrototypeOf(page), "pace");
  Object.defineProperty(page, "pace", {
    configurable: true, get: () => (%s ? 1 : 20) * get.call(page),
  }); } 0"""
"""Lets time pass as quickly as this machine can simulate until a condition holds."""
USUAL = "delete renetPage.page.pace"
"""Lets time pass as it does for visitors."""
PATIENT = """Object.defineProperty(renetPage.page, "pace", {
  configurable: true, get: () => (renetPage.stats.behind > 0.05 ? 0 : 1),
}); 0"""
"""Lets time stand still while this machine is behind: a page that simulates answers late."""
WALKS = "renetPage.stats.ready && renetPage.page.simulations[0].walking"
"""Condition that holds once the robots walk."""


class Visit:
    """The page as a visitor has it."""

    def __init__(self, page, url: str) -> None:
        self.page, self.url = page, url
        self.complaints, self.requests = watch(page)
        self.pace = USUAL

    def load(self, until: str = "renetPage.stats.ready") -> "Visit":
        self.page.goto(self.url)
        self.until(f"globalThis.renetPage && {until}")
        return self

    def until(self, condition: str) -> None:
        self.page.wait_for_function(condition, polling=100)

    def soon(self, condition: str) -> "Visit":
        """Wait until a condition of the simulation holds, in less than its time."""
        self.ask(QUICK % condition)
        self.until(condition)
        self.ask(self.pace)
        return self

    def undrawn(self) -> "Visit":
        """Draw no picture any more, and let time wait for a busy machine."""
        self.pace = PATIENT
        self.ask(f"renetPage.page.view.renderer.render = () => {{}}; {self.pace}")
        return self

    def ask(self, expression: str):
        return self.page.evaluate(expression)

    def its(self, expression: str):
        return self.ask(f"renetPage.page.{expression}")

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def place(self, selector: str, share: tuple[float, float] = (0.5, 0.5)) -> tuple[float, float]:
        """Point of an element, px, at shares of its width and height."""
        box = self.page.locator(selector).bounding_box()
        return box["x"] + share[0] * box["width"], box["y"] + share[1] * box["height"]

    def demand_order(self, parts: tuple[str, ...]) -> None:
        """Fail where visible parts lie upon each other, or beyond the sides of the window."""
        # All at one moment, as words that change move what is beside them.
        boxes = self.page.evaluate(BOXES, list(parts))
        assert len(boxes) >= 8
        for (first, a), (second, b) in combinations(boxes.items(), 2):
            across = min(a["x"] + a["width"], b["x"] + b["width"]) - max(a["x"], b["x"])
            down = min(a["y"] + a["height"], b["y"] + b["height"]) - max(a["y"], b["y"])
            assert min(across, down) <= 0.5, f"{first} lies upon {second}"
        size = self.page.viewport_size
        for part, box in boxes.items():
            assert 0 <= box["x"] <= box["x"] + box["width"] <= size["width"] + 0.5, part
            assert 0 <= box["y"] <= box["y"] + box["height"] <= size["height"] + 0.5, part
        assert self.ask("document.documentElement.scrollWidth") <= size["width"]

    def tap(self, place: tuple[float, float]) -> None:
        """Tap with a finger on a phone, click elsewhere; at once, for robots walk on."""
        phone = self.page.viewport_size == PHONE
        (self.page.touchscreen.tap if phone else self.page.mouse.click)(*place)
