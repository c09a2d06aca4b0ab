"""The page in a real browser: it walks, is blinded, stays up, and obeys every control."""

import json
import time
from collections.abc import Iterator
from typing import Any

import pytest

from tests.evaluation.report.browser import Browser, find_browser

PATIENCE = 500.0
"""Seconds after which a browser is ended."""
WIDTH = 1200


@pytest.fixture
def browser(address: str) -> Iterator[Browser]:
    """A browser with the page loaded and simulating."""
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium on this machine")
    browser = Browser(program, PATIENCE)
    browser.open(address, WIDTH, dark=False)
    until(browser, "Boolean(globalThis.renetPage) && renetPage.stats.pictures > 1")
    yield browser
    browser.close()


def until(browser: Browser, condition: str) -> None:
    """Wait for a JavaScript condition; the browser's own patience ends it."""
    while not browser.ask(condition):
        time.sleep(0.1)


def press(browser: Browser, key: str) -> None:
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=key)


def middle(browser: Browser, selector: str) -> dict[str, float]:
    """Where an element is in the window, once it has been scrolled there."""
    return browser.ask(
        f"""(() => {{ const one = document.querySelector("{selector}");
          one.scrollIntoView({{block: "center"}});
          const {{ x, y, width, height }} = one.getBoundingClientRect();
          return {{ x: x + width / 2, y: y + height / 2 }}; }})()"""
    )


def errors(browser: Browser) -> list[str]:
    """What the console complains of, without the browser's notes on drawing without a GPU."""
    said = [json.loads(complaint) for complaint in browser.complaints]
    return [str(one) for one in said if one.get("entry", {}).get("level") != "warning"]


def robots(browser: Browser) -> list[dict[str, Any]]:
    return browser.ask(
        """renetPage.page.simulations.map((one) => ({
          upright: one.upright, walking: one.walking, speed: one.speed, now: one.now,
          driving: one.controller.driving, estimator: one.controller.estimator,
        }))"""
    )


def test_renet_walks_on_when_it_is_blinded(browser: Browser, address: str):
    press(browser, "r")
    until(browser, "renetPage.page.now < 1 && !renetPage.page.opening")
    until(browser, "renetPage.page.now >= 5")
    vp, renet = robots(browser)
    assert (vp["driving"], renet["driving"]) == ("sees", "sees")
    press(browser, "3")
    assert browser.ask("renetPage.page.simulations[1].camera.fault.name") == "blackout"

    until(browser, "renetPage.page.now >= 20")

    vp, renet = robots(browser)
    assert (vp["driving"] or "sees", renet["driving"]) == ("sees", "blind")
    assert renet["upright"]
    assert renet["walking"]
    assert 0.5 < renet["speed"] < 0.9
    assert errors(browser) == []
    assert all(url.startswith((address, "blob:")) for url in browser.requests)


def test_every_control_answers_to_keys(browser: Browser):
    def pages(expression: str) -> Any:
        return browser.ask(f"renetPage.page.{expression}")

    speed = pages("controls.speed")
    press(browser, "w")
    press(browser, "ArrowUp")
    assert pages("controls.speed") == pytest.approx(speed + 0.2)
    press(browser, "s")
    assert pages("controls.speed") == pytest.approx(speed + 0.1)

    browser.call("Input.dispatchKeyEvent", type="keyDown", key="a")
    until(browser, "renetPage.page.controls.turn > 0.05")
    browser.call("Input.dispatchKeyEvent", type="keyUp", key="a")
    assert pages("controls.held.size") == 0

    press(browser, "1")
    press(browser, "-")
    fault = pages("simulations[0].camera.fault")
    assert (fault["name"], fault["severity"]) == ("gaussian", 4)
    assert pages("simulations[1].camera.fault.severity") == 4
    press(browser, "h")
    assert pages("simulations[0].camera.fault === null")
    for key in "---5":
        press(browser, key)
    assert pages("last") == 4
    until(browser, "document.querySelector('#repair').ariaPressed === 'true'")  # After 0.2 s.

    for rule, monitors in (("paper", 1), ("monitors", 8)):
        press(browser, "l")
        assert pages("rule.value") == rule
        assert 1 <= pages("simulations[1].controller.selector.monitors.length") <= monitors

    press(browser, "m")
    assert pages("simulations[1].controller.estimator") == "op"
    clicked = middle(browser, ".slot:nth-of-type(2) label:nth-of-type(3)")
    for kind in ("mousePressed", "mouseReleased"):
        browser.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **clicked)
    press(browser, "ArrowUp")
    assert pages("simulations[1].controller.estimator") == "op", "who clicked drives on"
    press(browser, "t")
    until(browser, "renetPage.page.simulations[0].now < 1 && !renetPage.page.wanted")
    assert pages("scene.name") == "platform"
    assert pages("simulations[1].controller.estimator") == "op"
    before = pages("simulations[0].world.data.qvel[1]")
    press(browser, "p")
    until(browser, f"Math.abs(renetPage.page.simulations[0].world.data.qvel[1] - {before}) > 0.1")
    press(browser, "r")
    until(browser, "renetPage.page.wanted === false && renetPage.page.now < 1")
    assert errors(browser) == []


def test_gamepad_and_touch_drive(browser: Browser):
    browser.ask(
        """(() => {
          const pressed = [{pressed: true}, {pressed: true}];
          navigator.getGamepads = () => [
            null, {mapping: "standard", axes: [0.8, 1, 0, 0], buttons: pressed}];
          return true;
        })()"""
    )
    until(browser, "renetPage.page.controls.stick < -0.5 && renetPage.page.fault !== null")
    until(browser, "renetPage.page.controls.turn < -0.01 && renetPage.page.controls.speed < 0.3")
    browser.ask("Boolean((navigator.getGamepads = () => { throw new Error('forbidden'); }))")
    until(browser, "renetPage.page.controls.stick === 0")

    touch = middle(browser, "#left")
    browser.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[touch])
    until(browser, "renetPage.page.controls.held.has('left')")
    browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    until(browser, "renetPage.page.controls.held.size === 0")


def test_everything_can_be_reached_with_tab(browser: Browser):
    reachable = browser.ask(
        """[...document.querySelectorAll("button, select, input")]
          .every((one) => one.tabIndex === 0 && 
            (!one.disabled || one.title.startsWith("This ground")))"""
    )
    assert reachable
    assert browser.ask("document.querySelectorAll('#faults button').length") == 30


def test_page_fits_a_phone(browser: Browser, address: str):
    browser.open(address, 390, dark=False)
    until(browser, "Boolean(globalThis.renetPage) && renetPage.stats.pictures > 1")
    assert browser.ask("document.documentElement.scrollWidth") <= 390
    assert errors(browser) == []


@pytest.mark.parametrize("missing", ["*estimator.onnx", "*three.module.js"])
def test_missing_file_is_named_on_the_page(browser: Browser, address: str, missing: str):
    browser.call("Network.setBlockedURLs", urls=[missing])
    browser.open(address, WIDTH, dark=False)
    until(browser, "document.querySelector('#message').textContent.startsWith('The page cannot')")
