"""The page in a real browser: its pictures, robots and ground, and what a visitor got wrong."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from renet.interface import LEGS, TRUNK
from renet.robots import GO2
from tests.browser import compare
from tests.page.visit import DESKTOP, NEWS, PARTS, PHONE, WALKS

pytestmark = pytest.mark.wall_clock

SCREENS = {
    "laptop": (1440, 900),
    "tablet": (768, 1024),
    "tablet on its side": (1024, 768),
    "phone with the bars of its browser": (390, 664),
    "small phone": (360, 640),
    "phone on its side": (844, 390),
    "small phone on its side": (667, 375),
}
"""Widths and heights beside `DESKTOP` and `PHONE`, px."""
LONGEST = """{ const { page } = renetPage;
for (const panel of page.panels) {
  panel.say("outcome", "Leapt the gap · 12.3 m", "");
  panel.say("driver", "remembers (VP)", "remembers");
  panel.say("why", "the image contradicts what was seen before", "");
  panel.say("ahead", "unseen ahead", "unseen");
  panel.say("walked", "0.60 m/s ahead, 0.30 m/s left, turns left at 0.80 rad/s", "");
  panel.update = () => {};
}
const sentence = "Switch fell 0.6 s after its camera broke. Memory leapt the gap from memory.";
Object.defineProperty(page.story, "sentence", { value: sentence });
page.driver.press("s");
page.driver.steer({ forward: -0.6, left: 0.4, turnRate: -0.8 }); } 0"""
"""Says the longest words that the page has, of robots that are driven."""
SPILT = """[...document.querySelectorAll(".drive > *, .bar > *")].filter((part) => {
  const [outer, inner] = [part.parentElement, part].map((one) => one.getBoundingClientRect());
  return part.checkVisibility() && (inner.top < outer.top || inner.bottom > outer.bottom);
}).map((part) => part.textContent)"""
"""Words of the controls that reach out of their boxes."""


def test_ground_lies_all_round_and_robots_that_fell_are_put_back(visit):
    one = visit("?ground=gap&fault=none").load().undrawn().soon(WALKS)
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
    one.soon("renetPage.page.now < 1 && !renetPage.page.resetDue")
    assert "back at the start" in one.its("notice")


def test_a_go2_stands_up_and_a_visitor_changes_to_the_go1(visit):
    one = visit("?robot=go2&ground=flat&fault=none")
    one.load().soon(WALKS)
    masses = mujoco.MjModel.from_xml_path(str(GO2.mjcf)).body_mass
    assert one.its("simulations[0].world.model.body_mass.slice(1)") == pytest.approx(masses[1:])
    assert one.its("simulations[0].world.pose().position[2]") > 0.2
    parts = [f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf")]
    drawn = one.its("runtime.look.map(({ name }) => name.split('-')[0])")
    assert {*drawn} == {TRUNK, *parts}, "by its own meshes"
    # A page that a visitor comes back to has the menu of when it was left.
    menu = one.page.locator("#bundle")
    begun = menu.input_value()
    menu.evaluate("menu => { menu.selectedIndex = 1 - menu.selectedIndex % 2; }")
    assert menu.input_value() != begun
    one.ask("dispatchEvent(new PageTransitionEvent('pageshow', { persisted: true }))")
    assert menu.input_value() == begun
    one.page.select_option("#bundle", label="Go1 · parkour")
    one.until("globalThis.renetPage?.page.runtime.bundle.robot === 'Unitree Go1'")
    assert "?robot=go1&bundle=go1-parkour&ground=" in one.page.url


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
    assert one.page.get_attribute("#more", "aria-expanded") == "false"
    one.page.click("#more")
    assert one.page.get_attribute("#more", "aria-expanded") == "true"
    fields = one.ask(
        """[...document.querySelectorAll("button, select, input")].map((field) => [
          field.tabIndex, field.ariaLabel || field.textContent || field.labels[0].textContent])"""
    )
    assert len(fields) > 18
    assert all(index == 0 and label.strip() for index, label in fields)
    assert one.page.locator("#faults button:visible").count() == 16


def test_the_longest_words_fit_on_screens_of_all_sizes(visit):
    one = visit("?robot=go1&bundle=go1-driven&ground=gap&fault=gaussian")
    one.page.route("**/*.onnx", lambda route: None)
    one.load("renetPage.stats.loaded > 0.5")
    one.ask(LONGEST)
    for name, (width, height) in SCREENS.items():
        one.page.set_viewport_size({"width": width, "height": height})
        one.until(f"renetPage.stats.pictures > {1 + one.ask('renetPage.stats.pictures')}")
        one.demand_order((*PARTS, *NEWS))
        assert one.ask(SPILT) == [], name


@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_first_pictures_are_the_golden_ones(visit, robot):
    """Before the models have come, robots stand still."""
    one = visit(f"?ground=gap&fault=blackout&robot={robot}")
    one.page.route("**/*.onnx", lambda route: None)
    one.load("renetPage.stats.loaded > 0.5")
    assert "%" in one.page.text_content("#message")
    # Of a status, screen readers would read out every per cent.
    assert one.page.locator("#message").aria_snapshot() == "- status: Loading"
    one.ask("document.querySelector('#message').style.opacity = 0")

    def demand(name: str) -> None:
        one.until(f"renetPage.stats.pictures > {3 + one.ask('renetPage.stats.pictures')}")
        golden = name if robot == "go1" else f"{robot}-{name}"
        compare(one.page.screenshot(), Path(__file__).with_name("golden") / f"{golden}.png")

    for name, size in (("desktop", DESKTOP), ("phone", PHONE)):
        one.page.set_viewport_size(size)
        demand(name)
        one.demand_order(PARTS)
    if robot == "go1":
        one.press("i")
        demand("hood")


@pytest.mark.parametrize(
    ("missing", "named"),
    [("**/estimator.onnx", "estimator.onnx"), ("**/three.module.js", "a script is missing")],
)
def test_missing_file_is_named_on_the_page(visit, missing, named):
    one = visit()
    one.page.route(missing, lambda route: route.abort())
    one.page.goto(one.url)
    one.until("document.querySelector('#message').textContent.startsWith('The page cannot')")
    assert named in one.page.text_content("#message")
    one.complaints.clear()


def test_a_browser_that_is_too_old_is_told_so(visit):
    one = visit()
    # As in Safari up to 16.3.
    one.page.add_init_script("delete globalThis.OffscreenCanvas")
    one.page.goto(one.url)
    one.until("document.querySelector('#message').textContent.startsWith('The page cannot')")
    assert "OffscreenCanvas" in one.page.text_content("#message")
    one.complaints.clear()


@pytest.mark.parametrize("plain", [True, False], ids=["without-gpu", "with-gpu"])
def test_scenes_that_begin_anew_leave_nothing_behind(visit, plain):
    one = visit("?ground=gap&fault=none", {"width": 300, "height": 300})
    if not plain:
        one.page.add_init_script("WebGL2RenderingContext.prototype.getExtension = () => null")
    one.page.route("**/*.onnx", lambda route: None)
    one.load("renetPage.stats.first")
    assert one.its("view.plain") == plain

    def begin_anew() -> dict[str, int]:
        """Numbers of geometries and textures on the GPU."""
        one.ask("renetPage.page.start()")
        one.until(f"renetPage.stats.pictures > {2 + one.ask('renetPage.stats.pictures')}")
        return one.its("view.renderer.info.memory")

    first = begin_anew()
    assert [begin_anew() for _ in range(3)] == [first] * 3


def test_the_time_for_which_a_page_was_hidden_is_in_no_picture(visit):
    one = visit("?ground=flat&fault=none")
    one.page.route("**/*.onnx", lambda route: None)
    one.load("renetPage.stats.first").undrawn()
    one.ask(
        """{ const { page } = renetPage, draw = page.draw.bind(page), frame = requestAnimationFrame;
        renetPage.longest = 0;
        page.draw = (seconds) => {
          renetPage.longest = Math.max(renetPage.longest, seconds);
          draw(seconds);
        };
        globalThis.requestAnimationFrame = (paint) => {
          globalThis.requestAnimationFrame = frame;
          setTimeout(() => {
            document.dispatchEvent(new Event("visibilitychange"));
            frame(paint);
            renetPage.back = true;
          }, 5000);
        }; } 0"""
    )
    one.until("renetPage.back")
    one.until(f"renetPage.stats.pictures > {2 + one.ask('renetPage.stats.pictures')}")
    assert 0 < one.ask("renetPage.longest") < 4
