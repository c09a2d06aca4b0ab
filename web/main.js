// "Break its camera": two copies of one robot, the same start, the same ground, the same fault.

import { Controls } from "./controls.js";
import { ESTIMATORS } from "./controller.js";
import { Panel } from "./panel.js";
import { loadModels, loadRuntime } from "./runtime.js";
import { Simulation } from "./simulation.js";
import { View } from "./view.js";

const OPENING = { terrain: "stairs_down", fault: "blackout", at: 4 };
/** The scene that opens the page: cameras fail by themselves, unless the visitor is faster. */
const PUSH = 1.0;
/** m/s to the left. */
const MOST_BEHIND = 0.4;
/** Seconds of simulation that are made up for; beyond, time runs slower than the clock. */
const BEHIND = 0.15;
/** Seconds of simulation from which pictures are rare, */
const RARELY = 250;
/** as many milliseconds apart. */

const NO_GLASS = "This ground has no obstacle that could be glass: choose Stairs up or Platform.";

const $ = (selector) => document.querySelector(selector);

async function read(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path}: ${answer.status} ${answer.statusText}`);
  return new Uint8Array(await answer.arrayBuffer());
}

class Page {
  constructor(runtime, look) {
    this.runtime = runtime;
    this.ready = false;
    const { contract, manifest } = runtime;
    for (const [state, colour] of Object.entries(contract.palette)) {
      document.documentElement.style.setProperty(`--${state}`, colour);
    }
    const slots = [...document.querySelectorAll(".slot")];
    this.panels = ["vp", "renet"].map(
      (estimator, n) => new Panel(slots[n], $(".instruments"), estimator, n),
    );
    this.panels.forEach((panel, n) => {
      panel.onMode = (name) => (this.simulations[n].controller.estimator = name);
    });
    this.view = new View($("#view"), slots, look, runtime);
    this.controls = new Controls({
      push: () => this.push(),
      reset: () => this.reset(),
      breakCamera: (index) => this.breakCamera(index),
      toggle: () => this.breakCamera(this.fault === null ? this.last : null),
      severity: () => this.showSeverity(true),
      nextTerrain: () => this.nextTerrain(),
      nextMode: () => this.nextMode(),
      nextRule: () => {
        this.rule.selectedIndex = 1 - this.rule.selectedIndex;
        this.rule.dispatchEvent(new Event("change"));
      },
    });
    this.rule = $("#rule");
    this.rule.addEventListener("change", () => {
      for (const { controller } of this.simulations) controller.select(this.rule.value);
    });
    this.last = contract.faults.findIndex(({ name }) => name === OPENING.fault);
    this.addFaults(contract.faults);
    this.addTerrains(contract.scenes);
    $("#about").textContent =
      `Bundle ${contract.bundle} of ${manifest.provenance.date}, renet ${contract.renet}. ` +
      "Physics: MuJoCo. Models: ONNX Runtime. Drawing: three.js. Nothing leaves this page.";
    this.scene = contract.scenes.find(({ name }) => name === OPENING.terrain);
    this.start();
    this.opening = true;
  }

  addFaults(faults) {
    const repair = chip("Healthy", "Repair both cameras (H)", () => this.breakCamera(null));
    repair.id = "repair";
    this.chips = faults.map(({ name, summary }, index) =>
      chip(title(name), index < 9 ? `${summary} (${index + 1})` : summary, () => this.breakCamera(index)),
    );
    $("#faults").append(repair, ...this.chips);
    this.repair = repair;
  }

  addTerrains(scenes) {
    const select = $("#terrain");
    select.append(...scenes.map(({ name, title: text }) => new Option(text, name)));
    select.addEventListener("change", () => this.setTerrain(select.value));
  }

  setTerrain(name) {
    this.scene = this.runtime.contract.scenes.find((scene) => scene.name === name);
    this.reset();
  }

  nextTerrain() {
    const { scenes } = this.runtime.contract;
    this.setTerrain(scenes[(scenes.indexOf(this.scene) + 1) % scenes.length].name);
  }

  nextMode() {
    const names = Object.keys(ESTIMATORS);
    const panel = this.panels[1];
    panel.estimator = names[(names.indexOf(panel.estimator) + 1) % names.length];
  }

  /** Start again, with other noise, after the control step that is under way. */
  reset() {
    this.wanted = true;
  }

  start() {
    this.wanted = false;
    for (const simulation of this.simulations ?? []) simulation.delete();
    const seed = Math.floor(2 ** 31 * Math.random());
    this.simulations = this.panels.map((panel) => {
      const simulation = new Simulation(this.runtime, this.scene, seed);
      simulation.controller.estimator = panel.estimator;
      simulation.controller.select(this.rule.value);
      return simulation;
    });
    this.controls.turn = 0;
    this.opening = false;
    this.story = "";
    $("#terrain").value = this.scene.name;
    for (const { curves } of this.panels) curves.clear();
    this.view.reset(this.simulations);
    const glass = this.runtime.contract.faults.findIndex(({ name }) => name === "glass");
    this.chips[glass].disabled = this.scene.glass === null;
    this.chips[glass].title = this.scene.glass ? this.runtime.contract.faults[glass].summary : NO_GLASS;
    this.breakCamera(null);
  }

  get now() {
    return this.simulations[0].now;
  }

  /** Give both cameras a fault of the catalogue by its index, or none. */
  breakCamera(index) {
    if (index !== null && this.chips[index].disabled) return;
    if (this.opening) this.story = "";
    this.opening = false;
    this.fault = index;
    if (index !== null) this.last = index;
    const fault = index === null ? null : this.runtime.contract.faults[index];
    for (const { camera, now } of this.simulations) {
      if (fault) camera.break(fault, this.controls.severity, now);
      else camera.repair();
    }
    this.chips.forEach((button, n) => press(button, n === index));
    press(this.repair, index === null);
    this.showSeverity(false);
  }

  showSeverity(changed) {
    if (changed && this.fault !== null) this.breakCamera(this.fault);
    const { described } = this.runtime.contract.faults[this.fault ?? this.last];
    const { severity } = this.controls;
    $("#level").textContent = `${severity} of 5: ${described[severity - 1]}`;
  }

  push() {
    for (const { world } of this.simulations) {
      const { rotation } = world.pose();
      world.push(rotation.slice(0, 2).map((row) => PUSH * row[1]));
    }
  }

  /** One control step of all robots. */
  async step() {
    const { contract } = this.runtime;
    const teleop = this.controls.command(contract.controlDt);
    if (this.opening && this.now >= OPENING.at - 1e-9) {
      this.breakCamera(contract.faults.findIndex(({ name }) => name === OPENING.fault));
      this.story = "Both cameras just went black.";
    }
    for (const [n, simulation] of this.simulations.entries()) {
      await simulation.step(teleop);
      this.panels[n].note(simulation);
    }
    const over = this.simulations.every(({ camera, now }) => !camera.broken(now));
    if (this.fault !== null && over) this.breakCamera(null);
    if (this.wanted) this.start();
  }

  draw(seconds) {
    this.controls.poll();
    this.simulations.forEach((simulation, n) => this.panels[n].update(simulation));
    this.view.draw(this.simulations, seconds);
    const left = OPENING.at - this.now;
    if (this.opening) this.story = left < 2 ? `Both cameras go black in ${Math.ceil(left)} …` : "Same robot, same start.";
    else if (left < -3) this.story = "";
    const message = $("#message");
    if (this.ready && message.textContent !== this.story) message.textContent = this.story;
  }
}

function chip(text, hint, onClick) {
  const button = document.createElement("button");
  Object.assign(button, { type: "button", textContent: text, title: hint });
  button.addEventListener("click", onClick);
  return button;
}

function press(button, down) {
  button.setAttribute("aria-pressed", String(down));
}

function title(name) {
  const words = name.replaceAll("_", " ");
  return words[0].toUpperCase() + words.slice(1);
}

function sleep(milliseconds) {
  return new Promise((resolve) => setTimeout(resolve, milliseconds));
}

/** Simulate in real time, however long pictures take; time stands still while nobody looks. */
async function simulate(page, stats) {
  const { controlDt } = page.runtime.contract;
  let last = performance.now();
  let debt = 0;
  for (;;) {
    await sleep(4);
    const now = performance.now();
    const passed = (now - last) / 1000;
    last = now;
    if (document.hidden) continue;
    stats.seconds += passed;
    debt = Math.min(debt + passed, MOST_BEHIND);
    stats.behind = debt;
    for (; debt >= controlDt; debt -= controlDt) {
      await page.step();
      stats.simulated += controlDt;
    }
  }
}

/** Draw as often as the view asks for; a simulation that falls behind comes first. */
async function draw(page, stats) {
  let last = performance.now();
  for (;;) {
    const pause = stats.behind > BEHIND ? RARELY : page.view.pause;
    if (pause > 0) await sleep(pause);
    const now = await new Promise(requestAnimationFrame);
    page.draw(Math.max(now - last, 1) / 1000);
    last = now;
    stats.pictures += 1;
    stats.first ??= performance.now();
  }
}

const stats = { simulated: 0, seconds: 0, pictures: 0, behind: 0 };
let page;
try {
  const [runtime, look] = await Promise.all([
    loadRuntime(read),
    read("go1.json").then((bytes) => JSON.parse(new TextDecoder().decode(bytes))),
  ]);
  page = new Page(runtime, look);
  globalThis.renetPage = { page, stats };
  const walk = async () => {
    while (!stats.first) await sleep(1);
    await loadModels(runtime, read);
    page.ready = true;
    await simulate(page, stats);
  };
  await Promise.all([draw(page, stats), walk()]);
} catch (error) {
  if (page) page.ready = false;
  $("#message").textContent = `The page cannot run here: ${error.message}`;
  throw error;
}
