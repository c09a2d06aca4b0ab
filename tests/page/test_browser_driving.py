"""The page in a real browser: it obeys keys, sticks, gamepads and the mouse."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.page.conftest import visiting
from tests.page.visit import DESKTOP, PHONE, WALKS, Visit

pytestmark = pytest.mark.wall_clock

DRIVEN = "?robot=go1&bundle=go1-driven&ground=flat&fault=none"
"""The scene with the bundle that goes in all directions."""
TOLD = "Array.from(renetPage.page.simulations[0].controller.observation.slice(6, 9))"
"""What the first robot's policy is told: (x, y, z)."""
STANDS = "x === 0 && y === 0 && z === 0"
"""What it is told then, while nobody asks for anything."""
GAMEPAD = """navigator.getGamepads = () => [null, renetPad];
globalThis.renetPad = { mapping: "standard", axes: [0, 0, 0, 0], buttons: [] };
for (let n = 0; n < 17; n += 1) renetPad.buttons.push({ pressed: false, value: 0 }); 0"""
"""Answers in the browser's place, as its Gamepad API does for an Xbox pad in the second port."""


@pytest.fixture(scope="module")
def window(browser, address) -> Iterator[Visit]:
    """Of all tests that drive in all directions, as a page takes long to load."""
    with visiting(browser, address) as visit:
        yield visit(DRIVEN).load().undrawn()


@pytest.fixture
def driven(window) -> Iterator[Visit]:
    """Robots that have just stood up, steered by the show."""
    window.page.set_viewport_size(DESKTOP)
    window.ask("delete navigator.getGamepads; renetPage.page.giveBack()")
    window.until("!renetPage.page.resetDue")
    yield window.soon(WALKS)
    window.page.mouse.up()


def test_every_control_answers_to_keys(visit):
    one = visit("?ground=flat&fault=none").load().undrawn()
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
    assert one.page.get_attribute("#explain", "aria-expanded") == "true"
    assert one.page.locator("#unseen").input_value() == "stop"
    one.until("renetPage.page.panels[1].curves.points.length > 3")
    one.press("i")
    assert one.page.locator("#hood").is_hidden()
    assert one.page.get_attribute("#explain", "aria-expanded") == "false"
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


class Fingers:
    """Fingers on a visit's screen, where Playwright's only tap."""

    def __init__(self, one: Visit) -> None:
        self.session = one.page.context.new_cdp_session(one.page)
        self.touching = False

    def hold(self, *places: tuple[float, float]) -> None:
        """Put fingers on points, px, and lift all others; the first stays the same finger."""
        points = [{"id": n, "x": x, "y": y} for n, (x, y) in enumerate(places)]
        kind = "touchMove" if self.touching else "touchStart"
        self.touching = bool(points)
        event = {"type": kind if points else "touchEnd", "touchPoints": points}
        self.session.send("Input.dispatchTouchEvent", event)


def told_soon(one: Visit, expected: str) -> None:
    """Wait until the first policy is told (x, y, z), of which a condition holds."""
    one.until(f"(([x, y, z]) => {expected})({TOLD})")


def test_a_visitor_drives_all_round_by_keys(driven):
    """What reaches the policy is what was asked for."""
    driven.press("w", "ArrowUp")
    told_soon(driven, "Math.abs(x - 0.8) < 1e-6 && y === 0")
    driven.until("document.querySelector('#asked').textContent === '0.80 m/s ahead'")
    for _ in range(20):
        driven.press("s")
    told_soon(driven, "Math.abs(x + 0.6) < 1e-6")
    driven.press(" ")
    told_soon(driven, STANDS)
    for keys, condition in (
        ("qj", "y > 0.3 && x === 0"),
        ("el", "y < -0.3"),
        ("a", "z > 0.7 && y === 0"),
        ("d", "z < -0.7"),
    ):
        for key in keys:
            driven.page.keyboard.down(key)
            told_soon(driven, condition)
            driven.page.keyboard.up(key)
            told_soon(driven, STANDS)


def test_the_robot_goes_where_a_visitor_drives_it(driven):
    walked = "renetPage.page.simulations[0].walked"
    for key, condition in (
        ("s", f"{walked}.forward < -0.3"),
        ("w", f"{walked}.forward > 0.3"),
        ("q", f"{walked}.left > 0.15"),
        ("e", f"{walked}.left < -0.15"),
        ("a", f"{walked}.turnRate > 0.5"),
        ("d", f"{walked}.turnRate < -0.5"),
    ):
        driven.press(" ")
        for _ in range(6 if key in "ws" else 0):
            driven.press(key)
        driven.page.keyboard.down(key)
        driven.soon(condition)
        driven.page.keyboard.up(key)
    assert not driven.its("simulations[0].fell")


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_visitor_drives_all_round_by_the_pad_and_gives_back(driven, size):
    driven.page.set_viewport_size(size)
    assert driven.page.locator("#show").is_hidden()
    mouse = driven.page.mouse
    for stick, (across, along), condition in (
        ("#go", (0, -1), "Math.abs(x - 1) < 1e-6 && y === 0"),
        ("#go", (0, 1), "Math.abs(x + 0.6) < 1e-6"),
        ("#go", (-1, 0), "y > 0.49 && x === 0"),
        ("#go", (1, 0), "y < -0.49"),
        ("#turn", (-1, 0), "z > 0.99"),
        ("#turn", (1, 0), "z < -0.99 && x === 0"),
    ):
        x, y = driven.place(stick)
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + 60 * across, y + 60 * along, steps=2)
        told_soon(driven, condition)
        mouse.up()
        told_soon(driven, STANDS)
    assert driven.its("driver.driven")
    driven.tap(driven.place("#go", (0.5, 0.95)))
    told_soon(driven, "Math.abs(x + 0.6) < 1e-6")  # It stays after a tap.
    driven.tap(driven.place("#stop"))
    told_soon(driven, STANDS)
    driven_for = driven.its("now")
    driven.page.click("#show")
    # The walk begins anew.
    driven.until(f"!renetPage.page.driver.driven && renetPage.page.now < {driven_for}")


def test_the_address_is_written_where_it_changes(visit):
    """Safari refuses more than 100 writes in 30 s; a key that is held comes that often in 4 s."""
    one = visit("?ground=flat&fault=gaussian").load().undrawn()
    one.ask(
        """renetPage.written = 0;
        const replace = history.replaceState.bind(history);
        history.replaceState = (...given) => { renetPage.written += 1; replace(...given); }; 0"""
    )
    for _ in range(5):
        one.page.keyboard.down("+")
    assert one.ask("renetPage.written") == 0
    one.press("-")
    assert "severity=4" in one.page.url
    assert one.ask("renetPage.written") == 1


def test_a_fault_behind_more_is_shown_while_it_is_at_work(visit):
    one = visit("?ground=flat&fault=none").load().undrawn()
    unplugged = one.page.locator("#faults button", has_text="Unplugged")
    assert unplugged.is_hidden()
    one.press("9")
    assert unplugged.is_visible()
    one.press("h")
    assert unplugged.is_hidden()


def plug_in(one: Visit, mapping: str) -> None:
    one.ask(
        f"""{{ const event = new Event("gamepadconnected");
        event.gamepad = {{ ...renetPad, mapping: "{mapping}" }};
        dispatchEvent(event); }} 0"""
    )


def test_a_visitor_drives_all_round_by_a_gamepad(driven):
    driven.ask(GAMEPAD)
    plug_in(driven, "")
    driven.until("document.querySelector('#message').textContent.includes('does not know')")
    plug_in(driven, "standard")
    driven.until("document.querySelector('#message').textContent.includes('left stick goes')")
    driven.ask("renetPad.axes = [0.05, -0.05, 0.05, 0]")  # Sticks are never quite in the middle.
    begun = driven.its("now")
    driven.until(f"renetPage.page.now > {begun} + 0.1")
    assert not driven.its("driver.driven")
    for axes, condition in (
        ([0, -1, 0, 0], "Math.abs(x - 1) < 1e-6 && y === 0"),
        ([0, 0.5, 0, 0], "Math.abs(x + 0.3) < 1e-6"),
        ([-1, 0, 0, 0], "y > 0.49 && x === 0"),
        ([1, 0, 0, 0], "y < -0.49"),
        ([0, 0, -1, 0], "z > 0.99 && y === 0"),
        ([0, 0, 1, 0], "z < -0.99 && x === 0"),
        ([0, 0, 0, 1], STANDS),
    ):
        driven.ask(f"renetPad.axes = {axes}")
        told_soon(driven, condition)
        driven.ask("renetPad.axes = [0, 0, 0, 0]")
        told_soon(driven, STANDS)
    driven.press("w")
    told_soon(driven, "x > 0")
    driven.ask("renetPad.buttons[1].pressed = true")
    told_soon(driven, STANDS)

    # In a frame whose page forbids gamepads, robots walk all the same.
    driven.ask("navigator.getGamepads = () => { throw new DOMException('', 'SecurityError'); }; 0")
    forbidden = driven.its("now")
    driven.until(f"renetPage.page.now > {forbidden} + 0.1")


def test_a_gamepad_with_a_single_stick_goes(driven):
    """Chromium calls a Joy-Con, which has two axes, standard."""
    driven.ask(GAMEPAD)
    driven.ask("renetPad.axes = [0, 0]")
    plug_in(driven, "standard")
    driven.until("document.querySelector('#message').textContent.includes('its stick goes')")
    begun = driven.its("now")
    driven.until(f"renetPage.page.now > {begun} + 0.1")
    assert not driven.its("driver.driven")
    driven.ask("renetPad.axes = [0, -1]")
    told_soon(driven, "Math.abs(x - 1) < 1e-6 && Number.isFinite(z)")
    # It leaves turning to keys.
    driven.page.keyboard.down("a")
    told_soon(driven, "Math.abs(x - 1) < 1e-6 && z > 0.7")
    driven.page.keyboard.up("a")
    driven.ask("renetPad.axes = [0, 0]")
    told_soon(driven, STANDS)


def test_the_stick_of_a_gamepad_that_turns_leaves_the_speed_of_keys(driven):
    """As the stick on the screen does."""
    driven.press("w")
    told_soon(driven, "Math.abs(x - 0.7) < 1e-6")
    driven.ask(GAMEPAD)
    driven.ask("renetPad.axes = [0, 0, -1, 0]")
    told_soon(driven, "z > 0.99 && Math.abs(x - 0.7) < 1e-6")
    driven.ask("renetPad.axes = [0, 0, 0, 0]")
    told_soon(driven, "z < 0.99 && Math.abs(x - 0.7) < 1e-6")


def test_a_stick_that_is_let_go_stands_whatever_another_finger_taps(driven):
    x, y = driven.place("#go")
    mouse = driven.page.mouse
    mouse.move(x, y)
    mouse.down()
    mouse.move(x, y - 60)
    told_soon(driven, "Math.abs(x - 1) < 1e-6")
    driven.page.touchscreen.tap(*driven.place("#turn"))
    mouse.up()
    told_soon(driven, STANDS)


def test_a_stick_follows_the_main_button_of_a_mouse_alone(driven):
    """The menu of another one would keep the news that it was let go."""
    driven.page.mouse.move(*driven.place("#go", (0.5, 0.05)))
    driven.page.mouse.down(button="right")
    driven.page.mouse.up(button="right")
    assert not driven.its("driver.driven")


def test_letters_of_other_scripts_are_taken_by_their_place(driven):
    """On a Russian keyboard W is Ц, and A is Ф."""
    driven.ask(
        """renetPage.strike = (type, key, code) =>
          document.body.dispatchEvent(new KeyboardEvent(type, { key, code, bubbles: true })); 0"""
    )
    driven.ask("renetPage.strike('keydown', 'Ц', 'KeyW')")
    told_soon(driven, "Math.abs(x - 0.7) < 1e-6")
    driven.ask("renetPage.strike('keydown', 'ф', 'KeyA')")
    told_soon(driven, "z > 0.7")
    driven.ask("renetPage.strike('keyup', 'ф', 'KeyA')")
    told_soon(driven, "z < 0.7")
    # A Latin letter is meant, wherever it is: Q of a French keyboard is where A is elsewhere.
    driven.ask("renetPage.strike('keydown', 'q', 'KeyA')")
    told_soon(driven, "y > 0.3 && z < 0.7")
    driven.ask("renetPage.strike('keyup', 'q', 'KeyA')")


def test_a_policy_that_is_told_headings_is_offered_what_it_follows(visit):
    one = visit("?ground=flat&fault=none").load().undrawn().soon(WALKS)
    assert one.page.locator("#go i").filter(visible=True).all_text_contents() == ["▲"]
    assert "cannot walk backward" in one.page.text_content("#refusal")
    assert one.page.locator(".all-round").filter(visible=True).count() == 0
    assert "cannot walk backward or sideways" in one.page.locator("#go").get_attribute("title")
    one.press("q")
    one.until("document.querySelector('#message').textContent.includes('cannot walk backward')")
    told_soon(one, "Math.abs(x - 0.6) < 1e-6")
    one.soon("renetPage.page.simulations[0].walked.forward > 0.3")
    yaw = "renetPage.page.simulations[0].world.pose().yaw"
    before = one.ask(yaw)
    one.page.keyboard.down("a")
    one.soon(f"Math.sin({yaw} - {before}) > 0.4")
    one.page.keyboard.up("a")
    one.press(" ")
    told_soon(one, "x === 0")
    one.soon("renetPage.page.simulations[0].walked.forward < 0.15")
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


def test_drag_pushes_a_robot_and_turns_the_view_elsewhere(visit):
    one = visit("?ground=flat&fault=none")
    one.load("renetPage.stats.first && renetPage.page.now > 0").undrawn()
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


def test_a_push_is_of_one_finger_and_of_one_scene(visit):
    one = visit("?ground=flat&fault=none")
    one.load("renetPage.stats.first && renetPage.page.now > 0").undrawn()
    one.ask("renetPage.pushes = []; renetPage.page.push = (by) => renetPage.pushes.push(by); 0")
    left, top, width, height = one.its("view.boxes[0]")
    robot = left + 0.5 * width, top + 0.42 * height
    moved = robot[0] + 60, robot[1]
    corner = left + 0.1 * width, top + 0.85 * height
    fingers = Fingers(one)
    fingers.hold(robot)
    fingers.hold(robot, corner)
    fingers.hold(robot, (corner[0] + 90, corner[1]))
    fingers.hold(robot)
    assert one.ask("renetPage.pushes") == []
    fingers.hold(moved)
    fingers.hold()
    (push,) = one.ask("renetPage.pushes.splice(0)")
    assert np.hypot(*push) == pytest.approx(0.6, abs=0.05)

    # Two fingers that turn the view, of which the second is on the robot, push nothing.
    fingers.hold(corner)
    fingers.hold(corner, robot)
    fingers.hold(corner, moved)
    fingers.hold()
    assert one.ask("renetPage.pushes") == []

    mouse = one.page.mouse
    mouse.move(*robot)
    mouse.down(button="right")
    mouse.move(*moved)
    mouse.up(button="right")
    assert one.ask("renetPage.pushes") == []

    mouse.move(*robot)
    mouse.down()
    one.ask("renetPage.page.view.draw = () => {}; renetPage.page.start()")
    mouse.move(*moved)
    mouse.up()
    assert one.ask("renetPage.pushes") == []


def test_a_finger_on_a_stick_leaves_the_view_to_the_other(visit):
    one = visit("?ground=flat&fault=none").load("renetPage.stats.first").undrawn()
    corner, stick, eye = (20, 300), one.place("#go"), "view.orbit.position.x"
    fingers = Fingers(one)
    fingers.hold(corner)
    fingers.hold(corner, stick)
    before = one.its(eye)
    fingers.hold(corner, (stick[0], stick[1] - 30))
    fingers.hold(corner, (stick[0] + 30, stick[1]))
    one.until(f"renetPage.stats.pictures > {2 + one.ask('renetPage.stats.pictures')}")
    assert one.its(eye) == before
    fingers.hold((corner[0] + 60, corner[1]))
    one.until(f"Math.abs(renetPage.page.{eye} - {before}) > 0.05")
    fingers.hold()
