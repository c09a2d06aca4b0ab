"""The page in a real browser: it tells its story, and a visitor tells his own."""

import re

import numpy as np
import pytest

from renet.palette import UNSEEN_AHEAD, UNSEEN_COLOUR, rgb
from tests.page.visit import DESKTOP, NEWS, PARTS, PHONE, WALKS

pytestmark = pytest.mark.wall_clock

TOPPLE = """for (const { world } of renetPage.page.simulations) {
  world.data.qpos.set([0, 1, 0, 0], world.free + 3);
} 0"""
"""Turns all robots upside down."""
VERDICT = "document.querySelector('#verdict').textContent"


@pytest.mark.parametrize("link", ["?ground=gap&fault=gaussian&severity=5", "?robot=go2"])
def test_every_opening_tells_its_story_and_is_played_again(visit, address, link):
    one = visit(link).load()
    one.ask(
        """const { page } = renetPage, apply = page.apply.bind(page);
        page.apply = (fault) => {
          renetPage.at = Math.max(...page.simulations.map((one) => one.world.pose().position[0]));
          apply(fault);
        }; 0"""
    )
    assert "will fail (noise)" in one.page.text_content("#message")
    one.soon("renetPage.at > 0")
    edge = one.its("scene.ground.obstacle[0]")
    assert one.ask("renetPage.at") == pytest.approx(edge - 0.3, abs=0.05)
    assert one.its("simulations.map((one) => one.camera.fault.name)") == ["gaussian"] * 2
    one.soon(VERDICT)

    fell, crossed = one.page.text_content("#verdict").split(". ")
    assert fell.startswith("Switch fell")
    assert fell.endswith("after its camera broke")
    assert crossed == "Memory leapt the gap from memory."
    left, right = one.page.locator(".outcome").all_text_contents()
    assert (left[:10], right[:13]) == ("Fell after", "Leapt the gap")
    robots = one.its("simulations.map(({ fell, state, upright }) => ({ fell, state, upright }))")
    assert [robot["fell"] for robot in robots] == [True, False]
    assert robots[1]["upright"] > 0.5
    assert robots[1]["state"] != "sees", "renet noticed"
    # Beyond the gap is ground that it has never seen.
    assert one.page.locator(".state .ahead").all_text_contents() == ["", UNSEEN_AHEAD]
    colours = one.ask("Array.from(renetPage.page.view.robots[1].map.instanceColor.array)")
    dots = 255 * np.reshape(colours, (-1, 3))
    assert (np.abs(dots - rgb(UNSEEN_COLOUR)).max(axis=1) < 1).mean() > 0.5
    one.soon("renetPage.page.now < 1")
    assert one.its("pending")
    assert all(url.startswith((address, "blob:", "data:")) for url in one.requests)


@pytest.mark.parametrize(
    ("size", "scheme"), [(DESKTOP, "light"), (PHONE, "dark")], ids=["desktop", "phone"]
)
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
    one.soon(VERDICT)
    one.demand_order((*PARTS, *NEWS))
    assert one.its("simulations.map((s) => s.camera.fault.name)") == ["gaussian"] * 2
    assert one.page.text_content("#verdict").endswith("Memory leapt the gap from memory.")
    assert one.its("driver.driven"), "and still drives"


def test_a_fall_is_timed_from_the_last_time_that_the_camera_broke(visit):
    one = visit("?ground=flat&fault=none").load().undrawn().soon(WALKS)
    one.press("1")
    one.until("renetPage.page.story.onset !== null")
    first = one.its("story.onset")
    one.press("h")
    one.until(f"renetPage.page.now > {first + 3.0}")
    one.press("1")
    one.until(f"renetPage.page.story.onset > {first + 3.0}")
    assert one.its("message") == "Both cameras just failed."
    one.ask(TOPPLE)
    one.until(VERDICT)
    told = re.search(r"fell ([\d.]+) s after its camera broke", one.page.text_content("#verdict"))
    assert told is not None
    assert float(told[1]) < 3.0


def test_a_fall_is_told_of_the_mode_in_which_it_was(visit):
    one = visit("?ground=flat&fault=none&left=switch&right=memory").load().undrawn().soon(WALKS)
    one.ask(TOPPLE)
    one.until(VERDICT)
    one.page.select_option(".slot:first-child select", "camera")
    one.until(f"renetPage.stats.pictures > {2 + one.ask('renetPage.stats.pictures')}")
    assert one.page.text_content("#verdict").startswith("Switch fell")
