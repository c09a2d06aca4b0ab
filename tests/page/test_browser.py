"""The page in a real browser: it tells its story, obeys every control, and fits a phone."""

from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
import pytest

from renet.interface import LEGS, TRUNK
from renet.palette import UNSEEN_AHEAD, UNSEEN_COLOUR, rgb
from renet.robots import GO2
from tests.browser import compare, open_browser, watch
from tests.page.conftest import served

pytestmark = pytest.mark.wall_clock

DESKTOP, PHONE = {"width": 1280, "height": 760}, {"width": 390, "height": 844}
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


class Visit:
    """The page as a visitor has it."""

    def __init__(self, page, url: str) -> None:
        self.page, self.url = page, url
        self.complaints, self.requests = watch(page)

    def load(self, until: str = "renetPage.stats.ready") -> "Visit":
        self.page.goto(self.url)
        self.until(f"globalThis.renetPage && {until}")
        return self

    def until(self, condition: str) -> None:
        self.page.wait_for_function(condition, polling=100)

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


@pytest.fixture(scope="module")
def browser():
    with open_browser() as browser:
        yield browser


@pytest.fixture
def visit(browser, address):
    """Makes visits, each in a window of its own, and ends them without a complaint."""
    visits: list[Visit] = []

    def make(
        query: str = "", size: dict[str, int] = DESKTOP, at: str = address, scheme: str = "light"
    ) -> Visit:
        context = browser.new_context(viewport=size, has_touch=size == PHONE, color_scheme=scheme)
        visits.append(Visit(context.new_page(), at + query))
        return visits[-1]

    yield make
    for one in visits:
        one.page.context.close()
        assert one.complaints == []


def test_a_link_tells_a_story_from_fault_to_outcome(visit, address):
    story = visit("?ground=gap&fault=gaussian&severity=5").load()
    story.ask(
        """const { page } = renetPage, apply = page.apply.bind(page);
        page.apply = (fault) => {
          renetPage.at = Math.max(...page.simulations.map((one) => one.world.pose().position[0]));
          apply(fault);
        }; 0"""
    )
    assert "will fail (noise)" in story.page.text_content("#message")
    story.until("renetPage.at > 0")
    edge = story.its("scene.ground.obstacle[0]")
    assert story.ask("renetPage.at") == pytest.approx(edge - 0.3, abs=0.05)
    assert story.its("simulations.map((one) => one.camera.fault.name)") == ["gaussian"] * 2
    story.until("document.querySelector('#verdict').textContent")

    robots = story.its("simulations.map(({ fell, state, upright }) => ({ fell, state, upright }))")
    sentence = story.page.text_content("#verdict")
    outcomes = story.page.locator(".outcome").all_text_contents()
    parts = sentence.split(". ")
    assert [words.split(" ")[0] for words in parts] == ["Switch", "Memory"]
    for robot, words, outcome in zip(robots, parts, outcomes, strict=True):
        assert ("fell" in words) == robot["fell"] == outcome.startswith("Fell after")
        assert robot["fell"] or robot["upright"] > 0.5
    assert robots[1]["state"] != "sees", "renet noticed"
    assert ("from memory" in parts[1]) == (not robots[1]["fell"])
    story.until("renetPage.page.now < 1")  # The show is played again.
    assert story.its("pending")
    assert all(url.startswith((address, "blob:", "data:")) for url in story.requests)


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_every_opening_shows_the_difference(visit, robot):
    """The show plays again by itself, with new noise."""
    one = visit(f"?robot={robot}").load()
    for _ in range(2):
        one.until("document.querySelector('#verdict').textContent")
        fell, crossed = one.page.text_content("#verdict").split(". ")
        assert fell.startswith("Switch fell")
        assert fell.endswith("after its camera broke")
        assert crossed == "Memory leapt the gap from memory."
        left, right = one.page.locator(".outcome").all_text_contents()
        assert (left[:10], right[:13]) == ("Fell after", "Leapt the gap")
        # Beyond the gap is ground that it has never seen.
        assert one.page.locator(".state .ahead").all_text_contents() == ["", UNSEEN_AHEAD]
        colours = one.ask("Array.from(renetPage.page.view.robots[1].map.instanceColor.array)")
        dots = 255 * np.reshape(colours, (-1, 3))
        assert (np.abs(dots - rgb(UNSEEN_COLOUR)).max(axis=1) < 1).mean() > 0.5
        one.until("!document.querySelector('#verdict').textContent")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_visitor_drives_breaks_the_camera_and_crosses(visit, size, scheme):
    one = visit("?ground=gap&fault=none", size, scheme=scheme)
    one.page.goto(one.url)
    one.until("globalThis.renetPage?.stats.first")
    ahead, noise = one.place("#go", (0.5, 0.05)), one.place("#faults button:nth-child(3)")
    # However slow this machine is, the visitor is quick: time waits at the edge.
    one.ask(
        """const { page } = renetPage, edge = page.scene.ground.obstacle[0];
        const reach = () => Math.max(...page.simulations.map((s) => s.world.pose().position[0]));
        Object.defineProperty(page, "pace", {
          configurable: true, get: () => (reach() > edge - 0.8 ? 0 : 1),
        }); 0"""
    )
    one.until("renetPage.stats.ready")
    one.tap(ahead)
    one.until("document.querySelector('#asked').textContent === '1.00 m/s ahead'")
    one.until("renetPage.page.pace === 0")
    one.demand_order((*PARTS, *NEWS))
    one.tap(noise)
    one.ask("delete renetPage.page.pace")
    one.until("document.querySelector('#verdict').textContent")
    one.demand_order((*PARTS, *NEWS))
    assert one.its("simulations.map((s) => s.camera.fault.name)") == ["gaussian"] * 2
    assert one.page.text_content("#verdict").endswith("Memory leapt the gap from memory.")
    assert one.its("driver.driven"), "and still drives"


def test_every_control_answers_to_keys(visit):
    one = visit("?ground=flat&fault=none").load()
    assert one.page.text_content("#pitch").endswith("the right robot remembers.")
    one.press("2", "-")
    fault = one.its("simulations.map(({ camera: { fault } }) => [fault.name, fault.severity])")
    assert fault == [["gaussian", 4]] * 2
    assert "fault=gaussian&severity=4" in one.page.url
    one.press("h")
    assert one.its("simulations[0].camera.fault === null")
    assert "fault=none" in one.page.url
    one.press("-", "-", "-", "7")
    one.until("renetPage.page.broken === null")  # Frozen at severity 1: after 0.2 s.

    for mode in ("switch", "camera", "blind"):
        one.press("m")
        assert one.its("simulations[1].controller.mode") == mode
        assert f"right={mode}" in one.page.url
        # The left robot is in the mode switch.
        assert "remembers" not in one.page.text_content("#pitch")
    for conduct in ("slow", "stop"):
        one.press("u")
        assert one.its("simulations.map((s) => s.controller.conduct)") == [conduct] * 2
        assert f"unseen={conduct}" in one.page.url
    one.press("i")
    assert one.page.locator("#hood").is_visible()
    assert one.page.locator("#unseen").input_value() == "stop"
    one.until("renetPage.page.panels[1].curves.points.length > 3")
    one.press("i")
    assert one.page.locator("#hood").is_hidden()
    one.press("t")
    one.until("renetPage.page.now < 1 && !renetPage.page.resetDue")
    assert one.its("scene.ground.name") == "gap"
    assert one.its("simulations[1].controller.mode") == "blind"
    assert one.its("simulations[1].controller.conduct") == "stop"
    before = one.its("simulations[0].world.data.qvel[1]")
    one.press("p")
    one.until(f"Math.abs(renetPage.page.simulations[0].world.data.qvel[1] - {before}) > 0.1")
    one.press("r")
    one.until("!renetPage.page.resetDue && renetPage.page.now < 1")


@pytest.fixture(scope="module")
def twist_address(twist_page: Path):
    with served(twist_page) as address:
        yield address


TOLD = "Array.from(renetPage.page.simulations[0].controller.observation.slice(6, 9))"
WALKS = "renetPage.stats.ready && renetPage.page.simulations[0].walking"


STAND = """for (const { controller: { policy } } of renetPage.page.simulations) {
  const act = policy.act.bind(policy);
  policy.act = async (...given) => (await act(...given)).fill(0);
} 0"""
"""Lets policies answer with the default pose: the shipped weights do not know twists, and fall."""


def told_soon(one: Visit, expected: str) -> None:
    """Wait until both policies are told (x, y, z), of which a condition holds."""
    one.until(f"(([x, y, z]) => {expected})({TOLD})")


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_visitor_drives_all_round_by_keys(visit, twist_address, size):
    """What reaches the policy is what was asked for; the robot itself stands."""
    one = visit("?ground=flat&fault=none", size, at=twist_address).load(WALKS)
    one.ask(STAND)
    assert one.page.locator("#show").is_hidden()
    one.press("w", "ArrowUp")
    told_soon(one, "Math.abs(x - 0.8) < 1e-6 && y === 0")
    one.until("document.querySelector('#asked').textContent === '0.80 m/s ahead'")
    for _ in range(20):
        one.press("s")
    told_soon(one, "Math.abs(x + 0.6) < 1e-6")
    one.press(" ")
    told_soon(one, "x === 0 && y === 0 && z === 0")
    for keys, condition in (
        ("qj", "y > 0.3 && x === 0"),
        ("el", "y < -0.3"),
        ("a", "z > 0.7 && y === 0"),
        ("d", "z < -0.7"),
    ):
        for key in keys:
            one.page.keyboard.down(key)
            told_soon(one, condition)
            one.page.keyboard.up(key)
            told_soon(one, "x === 0 && y === 0 && z === 0")
    driven_for = one.its("now")
    one.page.click("#show")
    # The walk begins anew.
    one.until(f"!renetPage.page.driver.driven && renetPage.page.now < {driven_for}")


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_visitor_drives_all_round_by_the_pad(visit, twist_address, size):
    one = visit("?ground=flat&fault=none", size, at=twist_address).load(WALKS)
    one.ask(STAND)
    mouse = one.page.mouse
    for stick, (across, along), condition in (
        ("#go", (0, -1), "Math.abs(x - 1) < 1e-6 && y === 0"),
        ("#go", (0, 1), "Math.abs(x + 0.6) < 1e-6"),
        ("#go", (-1, 0), "y > 0.49 && x === 0"),
        ("#go", (1, 0), "y < -0.49"),
        ("#turn", (-1, 0), "z > 0.99"),
        ("#turn", (1, 0), "z < -0.99 && x === 0"),
    ):
        x, y = one.place(stick)
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + 60 * across, y + 60 * along, steps=2)
        told_soon(one, condition)
        mouse.up()
        told_soon(one, "x === 0 && y === 0 && z === 0")
    assert one.its("driver.driven")
    one.tap(one.place("#go", (0.5, 0.95)))
    told_soon(one, "Math.abs(x + 0.6) < 1e-6")  # It stays after a tap.
    one.tap(one.place("#stop"))
    told_soon(one, "x === 0 && y === 0 && z === 0")


GAMEPAD = """navigator.getGamepads = () => [null, renetPad];
globalThis.renetPad = { mapping: "standard", axes: [0, 0, 0, 0], buttons: [] };
for (let n = 0; n < 17; n += 1) renetPad.buttons.push({ pressed: false, value: 0 }); 0"""
"""Answers in the browser's place, as its Gamepad API does for an Xbox pad in the second port."""


def plug_in(one: Visit, mapping: str) -> None:
    one.ask(
        f"""{{ const event = new Event("gamepadconnected");
        event.gamepad = {{ mapping: "{mapping}" }};
        dispatchEvent(event); }} 0"""
    )


def test_a_visitor_drives_all_round_by_a_gamepad(visit, twist_address):
    one = visit("?ground=flat&fault=none", at=twist_address).load(WALKS)
    one.ask(STAND)
    one.ask(GAMEPAD)
    plug_in(one, "")
    one.until("document.querySelector('#message').textContent.includes('does not know')")
    plug_in(one, "standard")
    one.until("document.querySelector('#message').textContent.includes('left stick goes')")
    one.ask("renetPad.axes = [0.05, -0.05, 0.05, 0]")  # Sticks are never quite in the middle.
    begun = one.its("now")
    one.until(f"renetPage.page.now > {begun} + 0.1")
    assert not one.its("driver.driven")
    for axes, condition in (
        ([0, -1, 0, 0], "Math.abs(x - 1) < 1e-6 && y === 0"),
        ([0, 0.5, 0, 0], "Math.abs(x + 0.3) < 1e-6"),
        ([-1, 0, 0, 0], "y > 0.49 && x === 0"),
        ([1, 0, 0, 0], "y < -0.49"),
        ([0, 0, -1, 0], "z > 0.99 && y === 0"),
        ([0, 0, 1, 0], "z < -0.99 && x === 0"),
        ([0, 0, 0, 1], "x === 0 && y === 0 && z === 0"),
    ):
        one.ask(f"renetPad.axes = {axes}")
        told_soon(one, condition)
        one.ask("renetPad.axes = [0, 0, 0, 0]")
        told_soon(one, "x === 0 && y === 0 && z === 0")
    one.press("w")
    told_soon(one, "x > 0")
    one.ask("renetPad.buttons[1].pressed = true")
    told_soon(one, "x === 0 && y === 0 && z === 0")

    # In a frame whose page forbids gamepads, robots walk all the same.
    one.ask("navigator.getGamepads = () => { throw new DOMException('', 'SecurityError'); }; 0")
    forbidden = one.its("now")
    one.until(f"renetPage.page.now > {forbidden} + 0.1")


def test_a_policy_that_is_told_headings_is_offered_what_it_follows(visit):
    one = visit("?ground=flat&fault=none").load(WALKS)
    assert one.page.locator("#go i").filter(visible=True).all_text_contents() == ["▲"]
    assert "cannot walk backward" in one.page.text_content("#refusal")
    assert one.page.locator(".all-round").filter(visible=True).count() == 0
    assert "cannot walk backward or sideways" in one.page.locator("#go").get_attribute("title")
    one.press("q")
    one.until("document.querySelector('#message').textContent.includes('cannot walk backward')")
    told_soon(one, "Math.abs(x - 0.6) < 1e-6")
    one.until("renetPage.page.simulations[0].walked.forward > 0.3")
    yaw = "renetPage.page.simulations[0].world.pose().yaw"
    before = one.ask(yaw)
    one.page.keyboard.down("a")
    one.until(f"Math.sin({yaw} - {before}) > 0.4")
    one.page.keyboard.up("a")
    one.press(" ")
    told_soon(one, "x === 0")
    one.until("renetPage.page.simulations[0].walked.forward < 0.15")
    assert one.its("driver.velocity") == {"forward": 0, "left": 0, "turnRate": 0}

    one.ask("renetPage.page.notice = ''")
    (x, y), mouse = one.place("#go"), one.page.mouse
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + 20, y - 30)
    # Such a policy is told the sine of its heading's error in place of a velocity to the left.
    told_soon(one, "x > 0.6")
    assert one.its("driver.velocity")["left"] == 0
    assert one.its("notice") == "", "of the part that it cannot do while it does the other"
    mouse.move(x + 30, y)
    one.until("renetPage.page.notice.includes('cannot walk backward')")
    mouse.up()

    one.ask("renetPage.page.notice = ''")
    one.ask(GAMEPAD)
    one.ask("renetPad.axes = [-1, 0, 0, 0]")
    one.until("renetPage.page.notice.includes('cannot walk backward')")
    assert one.its("driver.velocity") == {"forward": 0, "left": 0, "turnRate": 0}


def test_ground_lies_all_round_and_robots_that_fell_are_put_back(visit):
    one = visit("?ground=gap&fault=none").load(WALKS)
    heights = one.ask(
        """Array.from({ length: 16 }, (_, n) => renetPage.page.view.terrain.heightAt(
          300 * Math.cos(n * Math.PI / 8), 300 * Math.sin(n * Math.PI / 8)))"""
    )
    assert np.ptp(heights) == pytest.approx(0.0, abs=1e-6)
    one.press(" ")
    one.ask(
        """for (const { world } of renetPage.page.simulations) {
          world.data.qpos.set([0, 1, 0, 0], world.free + 3);
        } 0"""
    )
    one.until("renetPage.page.now < 1 && !renetPage.page.resetDue")
    assert "back at the start" in one.its("notice")


def test_drag_pushes_a_robot_and_turns_the_view_elsewhere(visit):
    one = visit("?ground=flat&fault=none").load("renetPage.stats.first && renetPage.page.now > 0")
    mouse, eye = one.page.mouse, "view.orbit.position.x"
    one.ask("renetPage.pushes = []; const { page } = renetPage; const push = page.push.bind(page);"
            "page.push = (by) => { renetPage.pushes.push(by); push(by); }; 0")  # fmt: skip
    box = one.its("view.boxes[0]")
    before = one.its(eye)
    for x, y in ((0.5, 0.42), (0.1, 0.85)):  # On the robot, and in a corner.
        mouse.move(box[0] + x * box[2], box[1] + y * box[3])
        mouse.down()
        mouse.move(box[0] + x * box[2] + 60, box[1] + y * box[3], steps=3)
        mouse.up()
        if x == 0.5:
            assert one.its(eye) == before
    (push,) = one.ask("renetPage.pushes")
    assert np.hypot(*push) == pytest.approx(0.6, abs=0.05)
    one.until(f"Math.abs(renetPage.page.{eye} - {before}) > 0.05")


def test_a_go2_stands_up_and_a_visitor_changes_to_the_go1(visit):
    one = visit("?robot=go2&ground=flat&fault=none")
    one.load("renetPage.page.simulations[0].walking")
    masses = mujoco.MjModel.from_xml_path(str(GO2.mjcf)).body_mass
    assert one.its("simulations[0].world.model.body_mass.slice(1)") == pytest.approx(masses[1:])
    assert one.its("simulations[0].world.pose().position[2]") > 0.2
    parts = [f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf")]
    drawn = one.its("runtime.look.map(({ name }) => name.split('-')[0])")
    assert {*drawn} == {TRUNK, *parts}, "by its own meshes"
    one.page.select_option("#bundle", label="Go1")
    one.until("globalThis.renetPage?.page.runtime.bundle.robot === 'Unitree Go1'")
    assert "?robot=go1&ground=" in one.page.url


def test_a_robot_that_lies_in_a_gap_is_seen(visit):
    one = visit("?ground=gap&fault=none")
    one.page.route("**/*.onnx", lambda route: None)
    one.load("renetPage.stats.first")
    one.ask(
        """const { view, simulations: [{ world }], scene: { ground } } = renetPage.page;
        const x = (ground.obstacle[0] + ground.obstacle[1]) / 2;
        renetPage.lie = (yaw) => {
          world.data.qpos.set([x, 0, -0.6, Math.cos(yaw / 2), 0, 0, Math.sin(yaw / 2)], world.free);
          world.mujoco.mj_forward(world.model, world.data);
          view.followed[0] = null;
        };
        renetPage.above = () => {
          const [eye, at] = [view.cameras[0].position, view.followed[0].position];
          const share = Array.from({ length: 50 }, (_, n) => n / 50);
          return share.every((s) => {
            const { x, y, z } = eye.clone().lerp(at, s);
            return z > view.terrain.heightAt(x, y);
          });
        }; 0"""
    )
    for yaw in (0.0, 1.57):
        one.ask(f"renetPage.lie({yaw})")
        one.until("renetPage.page.view.followed[0]?.position.z < -0.5 && renetPage.above()")


def test_a_wrong_link_is_corrected_and_everything_can_be_reached_with_tab(visit):
    one = visit("?ground=moon&fault=none&severity=9&unseen=fly").load("renetPage.stats.first")
    one.until("document.querySelector('#message').textContent.includes('moon')")
    assert one.its("scene.severity") == 5
    assert one.its("scene.conduct") == "walk"
    assert one.its("scene.ground.name") == one.its("runtime.bundle.opening.ground")
    one.page.click("#more")
    fields = one.ask(
        """[...document.querySelectorAll("button, select, input")].map((field) => [
          field.tabIndex, field.ariaLabel || field.textContent || field.labels[0].textContent])"""
    )
    assert len(fields) > 18
    assert all(index == 0 and label.strip() for index, label in fields)
    assert one.page.locator("#faults button:visible").count() == 16


@pytest.mark.parametrize("name", ["desktop", "phone", "hood", "go2-desktop", "go2-phone"])
def test_first_picture_is_the_golden_one(visit, name):
    """Before the models have come, robots stand still."""
    size, go2 = DESKTOP if "desktop" in name else PHONE, "go2" in name
    one = visit(f"?ground=gap&fault=blackout{'&robot=go2' if go2 else ''}", size)
    one.page.route("**/*.onnx", lambda route: None)
    one.load("renetPage.stats.pictures > 3 && renetPage.stats.loaded > 0.5")
    assert "%" in one.page.text_content("#message")
    one.ask("document.querySelector('#message').style.opacity = 0")
    if name == "hood":
        one.press("i")
    else:
        one.demand_order(PARTS)
    compare(one.page.screenshot(), Path(__file__).with_name("golden") / f"{name}.png")


@pytest.mark.parametrize("missing", ["**/estimator.onnx", "**/three.module.js"])
def test_missing_file_is_named_on_the_page(visit, missing):
    one = visit()
    one.page.route(missing, lambda route: route.abort())
    one.page.goto(one.url)
    one.until("document.querySelector('#message').textContent.startsWith('The page cannot')")
    one.complaints.clear()
