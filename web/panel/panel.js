// What is said and shown of one robot: who drives, what became of it, what it sees, its curves.

import { ESTIMATORS } from "../control/controller.js";
import { Curves, drawDepth } from "./plots.js";

export class Panel {
  /** `onMode` is told whenever the visitor chooses who drives. */
  constructor(slot, instruments, estimator, { palette }, onMode) {
    this.palette = palette;
    this.shown = new Map();
    const modes = Object.entries(ESTIMATORS).map(([name, title]) => `<option value="${name}">${title}</option>`);
    slot.innerHTML = `
      <div class="who"><select aria-label="Who drives this robot" title="Who drives this robot (M)">
        ${modes.join("")}</select>
        <p class="outcome"></p></div>
      <p class="state"><span class="driver"></span> <span class="why"></span></p>
      <figure class="eye"><canvas width="64" height="48"></canvas>
        <figcaption>what it gets</figcaption></figure>`;
    this.slot = slot;
    this.mode = slot.querySelector("select");
    this.mode.value = estimator;
    this.mode.addEventListener("change", () => onMode(this.estimator));
    const box = document.createElement("div");
    box.innerHTML = `<h3></h3><figure><canvas width="64" height="48"></canvas></figure>
      <div class="curves"></div>`;
    instruments.append(box);
    this.title = box.querySelector("h3");
    this.eye = slot.querySelector(".eye");
    this.depth = slot.querySelector("canvas");
    this.reconstruction = box.querySelector("canvas");
    this.curves = new Curves(box.querySelector(".curves"), palette);
  }

  get estimator() {
    return this.mode.value;
  }

  get name() {
    return ESTIMATORS[this.estimator];
  }

  /** Keep one control step for the curves. */
  note({ now, state, camera, controller: { policy, selector } }) {
    const monitor = selector.monitors.find(({ output }) => output);
    const surprise = monitor ? policy[monitor.output] / monitor.threshold : 0;
    this.curves.add({ now, surprise, trust: selector.probability, state, broken: camera.broken(now) });
  }

  /** Show a simulation as it is now; `outcome` in words. */
  update(simulation, outcome) {
    const { controller, camera, state, fell } = simulation;
    const { selector, policy } = controller;
    this.say("outcome", outcome, fell ? "fell" : "");
    this.say("driver", this.palette[state]?.says ?? (fell ? "braked" : ""), state);
    const objects = state && selector.state !== "sees";
    const whose = ["memory", "forgets"].includes(controller.estimator) ? "" : "renet would object: ";
    this.say("why", objects ? whose + selector.reason : "", "");
    this.show(this.depth, camera.frame?.image);
    this.eye.classList.toggle("broken", camera.broken(simulation.now));
    if (!this.curves.box.clientWidth) return;
    this.title.textContent = this.name;
    this.show(this.reconstruction, state ? policy.reconstruction : null);
    this.curves.draw();
  }

  say(part, words, kind) {
    const element = this.slot.querySelector(`.${part}`);
    if (element.textContent !== words) element.textContent = words;
    element.className = `${part} ${kind}`;
  }

  /** Draw a depth image where it is another than the one that is shown. */
  show(canvas, image) {
    if (this.shown.get(canvas) === image) return;
    this.shown.set(canvas, image);
    drawDepth(canvas, image);
  }
}
