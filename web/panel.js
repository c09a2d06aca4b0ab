// What is said and shown of one robot: its controller, who drives, what it sees, its curves.

import { ESTIMATORS } from "./controller.js";
import { Curves, depthGradient, drawDepth } from "./plots.js";

const SAID = {
  sees: "sees: vision (VP) drives",
  remembers: "remembers: VP drives from memory",
  blind: "blind (OP) drives",
};

const CURVES_EVERY = 0.1;
/** Seconds between drawings of the curves. */

export class Panel {
  constructor(slot, instruments, estimator, number) {
    this.onMode = () => {};
    this.shown = new Map();
    this.drawnAt = -Infinity;
    const modes = Object.entries(ESTIMATORS)
      .map(
        ([name, title]) => `<label title="Who drives this robot">
          <input type="radio" name="mode-${number}" value="${name}"
            ${name === estimator ? "checked" : ""} /><span>${title}</span></label>`,
      )
      .join("");
    slot.innerHTML = `<div class="modes" role="radiogroup" aria-label="Controller">${modes}</div>
      <div class="state"><span class="driver"></span><span class="speed"></span>
      <span class="why"></span></div>`;
    this.radios = [...slot.querySelectorAll("input")];
    for (const radio of this.radios) radio.addEventListener("change", () => this.onMode(radio.value));
    this.said = Object.fromEntries(
      ["driver", "speed", "why"].map((name) => [name, slot.querySelector(`.${name}`)]),
    );
    const box = document.createElement("div");
    box.className = "instrument";
    box.innerHTML = `
      <figure><canvas class="depth" width="64" height="48"></canvas>
        <figcaption>Depth it gets · 0 <i class="scale"></i> 2 m</figcaption></figure>
      <figure><canvas class="depth" width="64" height="48"></canvas>
        <figcaption>Its reconstruction</figcaption></figure>
      <figure class="curves"><canvas class="plot"></canvas>
        <figcaption>Loss against β, vision probability P, and who drives:
        it <b style="color: var(--sees)">sees</b>, <b style="color: var(--remembers)">remembers</b>
        or is <b style="color: var(--blind)">blind</b>, last 12 s
        </figcaption></figure>`;
    box.querySelector(".scale").style.background = depthGradient;
    instruments.append(box);
    [this.depth, this.reconstruction] = box.querySelectorAll(".depth");
    this.curves = new Curves(box.querySelector(".plot"));
  }

  get estimator() {
    return this.radios.find((radio) => radio.checked).value;
  }

  set estimator(name) {
    for (const radio of this.radios) radio.checked = radio.value === name;
    this.onMode(name);
  }

  /** Keep one control step for the curves. */
  note({ now, camera, controller, walking }) {
    this.curves.add({
      now,
      loss: controller.policy.anomalyScore,
      probability: controller.selector.probability,
      driving: walking ? controller.driving : "",
      broken: camera.broken(now),
    });
  }

  /** Show a simulation as it is now. */
  update(simulation) {
    const { controller, camera, walking, upright, speed } = simulation;
    const { driving, selector, reason, estimator } = controller;
    const fell = !upright || (reason !== "start" && controller.mode === "damping");
    const { driver, speed: pace, why } = this.said;
    driver.textContent = fell ? "fell" : walking ? SAID[driving] : "standing up";
    driver.className = `driver ${fell ? "bad" : walking ? driving : ""}`;
    pace.textContent = walking ? `${speed.toFixed(2)} m/s` : "";
    const objects = walking && selector.state !== "sees";
    why.textContent = objects ? (estimator === "renet" ? "" : "the selector would object: ") + selector.reason : "";
    this.show(this.depth, camera.frame?.image);
    this.show(this.reconstruction, walking ? controller.policy.reconstruction : null);
    if (Math.abs(simulation.now - this.drawnAt) < CURVES_EVERY) return;
    this.drawnAt = simulation.now;
    this.curves.draw(selector.beta);
  }

  /** Draw a depth image where it is another than the one that is shown. */
  show(canvas, image) {
    if (this.shown.get(canvas) === image) return;
    this.shown.set(canvas, image);
    drawDepth(canvas, image);
  }
}
