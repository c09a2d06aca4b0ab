// What is said and shown of one robot: who drives, what became of it, what it sees, its curves.

import { Curves, drawDepth } from "./plots.js";
import { WALKED, velocityWords } from "./words.js";

/** What each mode of the pilot is, beside its name. */
const GLOSSES = {
  memory: "renet's",
  switch: "the paper's",
  camera: "always",
  blind: "always",
};

export class Panel {
  /**
   * @param {HTMLElement} slot half of the stage.
   * @param {HTMLElement} instruments where curves are shown.
   * @param {string} mode of the pilot that drives this robot.
   * @param {object} contract modes, palette.
   * @param {(mode: string) => void} onMode told whenever the visitor chooses another.
   */
  constructor(slot, instruments, mode, { modes, palette }, onMode) {
    this.palette = palette;
    this.shown = new Map();
    const options = modes.map((name) => {
      const title = name in GLOSSES ? `${capital(name)} (${GLOSSES[name]})` : capital(name);
      return `<option value="${name}">${title}</option>`;
    });
    slot.innerHTML = `
      <div class="who"><select aria-label="Mode of this robot" title="Who drives this robot (M)">
        ${options.join("")}</select>
        <p class="outcome"></p></div>
      <p class="state"><span class="driver"></span> <span class="why"></span> <span class="ahead"></span>
        <span class="walked"></span></p>
      <figure class="eye"><canvas width="64" height="48"></canvas>
        <figcaption>what it gets</figcaption></figure>`;
    this.slot = slot;
    this.select = slot.querySelector("select");
    this.select.value = mode;
    this.select.addEventListener("change", () => onMode(this.mode));
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

  /** Mode of the pilot. */
  get mode() {
    return this.select.value;
  }

  /** Keep one control step for the curves. */
  note({ now, state, camera, controller: { policy, selector } }) {
    const monitor = selector.monitors.find(({ output }) => output);
    const anomaly = monitor ? policy[monitor.output] / monitor.threshold : 0;
    this.curves.add({ now, anomaly, trust: selector.probability, state, broken: camera.broken(now) });
  }

  /** Show a simulation as it is now; `outcome` in words. */
  update(simulation, outcome) {
    const { controller, camera, state, fell, walked } = simulation;
    const { selector, policy } = controller;
    this.say("outcome", outcome, fell ? "fell" : "");
    this.say("driver", this.palette[state]?.says ?? (fell ? "braked" : ""), state);
    const objects = state && selector.state !== "sees";
    const whose = controller.obeys ? "" : "memory would object: ";
    this.say("why", objects ? whose + selector.reason : "", "");
    const { unseen } = this.palette;
    this.say("ahead", state && controller.unseen ? unseen.says : "", "unseen");
    this.say("walked", state ? velocityWords(walked, WALKED) : "", "");
    this.show(this.depth, camera.frame?.image);
    this.eye.classList.toggle("broken", camera.broken(simulation.now));
    if (!this.curves.box.clientWidth) return;
    this.title.textContent = capital(this.mode);
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

function capital(words) {
  return words[0].toUpperCase() + words.slice(1);
}
