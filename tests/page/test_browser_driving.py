"""The page in a real browser: it obeys keys, sticks, gamepads and the mouse."""

import numpy as np
import pytest

from tests.page.visit import DESKTOP, PHONE, WALKS, Visit

pytestmark = pytest.mark.wall_clock

DRIVEN = "?robot=go1&bundle=go1-driven&ground=flat&fault=none"
"""The scene with the bundle that goes in all directions."""
TOLD = "Array.from(renetPage.page.simulations[0].controller.observation.slice(6, 9))"
"""What the first robot's policy is told: (x, y, z)."""
GAMEPAD = """navigator.getGamepads = () => [null, renetPad];
globalThis.renetPad = { mapping: "standard", axes: [0, 0, 0, 0], buttons: [] };
for (let n = 0; n < 17; n += 1) renetPad.buttons.push({ pressed: false, value: 0 }); 0"""
"""Answers in the browser's place, as its Gamepad API does for an Xbox pad in the second port."""


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


def told_soon(one: Visit, expected: str) -> None:
    """Wait until both policies are told (x, y, z), of which a condition holds."""
    one.until(f"(([x, y, z]) => {expected})({TOLD})")


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_visitor_drives_all_round_by_keys(visit, size):
    """What reaches the policy is what was asked for."""
    one = visit(DRIVEN, size).load().soon(WALKS)
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


def test_the_robot_goes_where_a_visitor_drives_it(visit):
    one = visit(DRIVEN).load().soon(WALKS)
    walked = "renetPage.page.simulations[0].walked"
    for key, condition in (
        ("s", f"{walked}.forward < -0.3"),
        ("w", f"{walked}.forward > 0.3"),
        ("q", f"{walked}.left > 0.15"),
        ("e", f"{walked}.left < -0.15"),
        ("a", f"{walked}.turnRate > 0.5"),
        ("d", f"{walked}.turnRate < -0.5"),
    ):
        one.press(" ")
        for _ in range(6 if key in "ws" else 0):
            one.press(key)
        one.page.keyboard.down(key)
        one.soon(condition)
        one.page.keyboard.up(key)
    assert not one.its("simulations[0].fell")


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_visitor_drives_all_round_by_the_pad(visit, size):
    one = visit(DRIVEN, size).load().soon(WALKS)
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


def plug_in(one: Visit, mapping: str) -> None:
    one.ask(
        f"""{{ const event = new Event("gamepadconnected");
        event.gamepad = {{ mapping: "{mapping}" }};
        dispatchEvent(event); }} 0"""
    )


def test_a_visitor_drives_all_round_by_a_gamepad(visit):
    one = visit(DRIVEN).load().soon(WALKS)
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
    one = visit("?ground=flat&fault=none").load().soon(WALKS)
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
