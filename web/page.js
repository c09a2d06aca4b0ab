// "Break its camera": two copies of one robot, the same start, the same ground, the same fault.

import { Controls } from "./panel/controls.js";
import { Driver, SHOW } from "./panel/driver.js";
import { Gamepad } from "./panel/gamepad.js";
import { bundleLink, sceneLink } from "./panel/link.js";
import { Pad } from "./panel/pad.js";
import { Panel } from "./panel/panel.js";
import { drawDepth } from "./panel/plots.js";
import { BEFORE, Story } from "./panel/story.js";
import { ASKED, velocityWords } from "./panel/words.js";
import { View } from "./stage/view.js";
import { DepthCamera, makeFault } from "./world/camera.js";
import { Simulation } from "./world/simulation.js";

const LATER = 4;
/** Seconds after the start at which cameras break on ground without an obstacle. */
const SIDEWAYS = 1;
/** m/s to the left of the push of the key and the button. */
const SLOW_MOTION = { pace: 0.25, milliseconds: 2000 };
/** How slowly time runs while a robot falls, and for how long. */
const PICTURES = 6;
/** Faults that are shown at once; the others are behind "More". */
const KEYS = 9;
/** Faults that have a key, 1 to 9. */
const PICTURED = 2;
/** Seconds after its beginning of which a fault's picture is. */
const LOOP = 6;
/** Seconds from the end of the story to the next time that the show is played. */
const PUT_BACK = 3;
/** Seconds for which robots of which none stands are left where they lie. */
const NOTICE = 5000;
/** Milliseconds for which a notice is shown. */

const CONDUCTS = { walk: "walk on", slow: "slow down", stop: "stop" };
/** What robots do at the end of the ground that they have seen, as the menu says it. */

const $ = (selector) => document.querySelector(selector);

export class Page {
  /** @param {object} runtime of load.js. @param {object} scene of link.js. */
  constructor(runtime, scene) {
    Object.assign(this, { runtime, scene });
    // It waits until the models have come, however long that takes.
    this.notice = scene.unknown.length ? `The link asks for ${scene.unknown.join(" and ")}: not here.` : "";
    const { contract, manifest, bundle } = runtime;
    const { bundles, palette } = contract;
    for (const [name, { colour, ink }] of Object.entries(palette)) {
      document.documentElement.style.setProperty(`--${name}`, colour);
      document.documentElement.style.setProperty(`--on-${name}`, ink);
    }
    const slots = [...document.querySelectorAll(".slot")];
    this.panels = scene.modes.map((mode, n) => {
      const choose = (name) => this.chooseMode(n, name);
      return new Panel(slots[n], $(".instruments"), mode, contract, choose);
    });
    this.view = new View($("#view"), slots, runtime, (push) => this.push(push));
    this.driver = new Driver(
      bundle.told,
      contract.steering,
      (why) => this.notify(asSentence(why)),
      () => this.takeOver(),
    );
    const allRound = this.driver.offers("left", 1);
    for (const part of document.querySelectorAll(".all-round")) part.hidden = !allRound;
    $("#refusal").textContent = allRound ? "" : asSentence(contract.steering.forwardOnly);
    $("#chosen").hidden = bundle.opening.left !== "switch";
    this.pad = new Pad($("#go"), $("#turn"), this.driver);
    this.gamepad = new Gamepad(this.driver, (words) => this.notify(words));
    $("#severity").value = scene.severity;
    this.controls = new Controls(this);
    this.addFaults(contract.faults);
    fillSelect($("#ground"), bundle.grounds, (name) => this.setGround(name));
    const conducts = Object.keys(contract.reach.speeds).map((name) => ({ name, title: CONDUCTS[name] }));
    fillSelect($("#unseen"), conducts, (conduct) => this.chooseConduct(conduct));
    $("#unseen").value = scene.conduct;
    const visit = (n) => (location.search = bundleLink(bundles[n], bundles));
    fillSelect($("#bundle"), bundles.map(({ title }, n) => ({ name: n, title })), visit);
    // Browsers show a page that a visitor comes back to as it was left, with the robot that was chosen.
    const nameBundle = () => ($("#bundle").selectedIndex = bundles.indexOf(bundle));
    addEventListener("pageshow", nameBundle);
    nameBundle();
    $("#bundle").hidden = bundles.length < 2;
    for (const button of ["#explain", "#close"]) $(button).addEventListener("click", () => this.explain());
    $("#about").textContent =
      `Bundle ${bundle.name} (${bundle.robot}) of ${manifest.provenance.date}, renet ${contract.renet}. ` +
      (manifest.selector.healthy_hours === 0 ? "Its monitors are not calibrated to its images. " : "") +
      "Physics: MuJoCo. Models: ONNX Runtime. Drawing: three.js, uPlot. Nothing leaves this page.";
    this.start();
  }

  /** Show some words for a while. */
  notify(words) {
    this.notice = words;
    clearTimeout(this.noticed);
    this.noticed = setTimeout(() => (this.notice = ""), NOTICE);
  }

  /** Let robot `n` be driven in a mode of the pilot from now on. */
  chooseMode(n, mode) {
    this.scene.modes[n] = mode;
    this.simulations[n].controller.choose(mode);
    this.show();
  }

  /** Let both robots behave so at the end of the ground that they have seen, from now on. */
  chooseConduct(conduct) {
    this.scene.conduct = conduct;
    for (const { controller } of this.simulations) controller.conduct = conduct;
    this.show();
  }

  /** The visitor steers from now on, and breaks the cameras when it pleases. */
  takeOver() {
    this.pending = false;
    const where = this.scene.ground.obstacle ? "just before the edge" : "whenever you like";
    this.notify(this.broken ? "You drive." : `You drive. Break the cameras ${where}.`);
    this.show();
  }

  /** Let the show steer, from the start of its scene. */
  giveBack() {
    this.driver.giveBack();
    this.reset();
  }

  addFaults(faults) {
    const tile = (title, hint, onClick) => {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", title: hint });
      button.innerHTML = `<canvas width="64" height="48"></canvas><span>${title}</span>`;
      button.addEventListener("click", onClick);
      return button;
    };
    this.healthy = tile("Healthy", "Repair both cameras (H)", () => this.breakCamera(null));
    this.tiles = faults.map(({ title, summary }, n) =>
      tile(title, n < KEYS ? `${summary} (${n + 1})` : summary, () => this.breakCamera(n)),
    );
    const more = tile("More", "More faults", () => expand(more, $("#faults").classList.toggle("all")));
    expand(more, false);
    more.querySelector("canvas").remove();
    more.id = "more";
    this.tiles.slice(PICTURES).forEach((button) => button.classList.add("extra"));
    $("#faults").append(this.healthy, ...this.tiles.slice(0, PICTURES), more, ...this.tiles.slice(PICTURES));
  }

  /** Show what each fault makes of the image at the start; faults of time have their words. */
  drawFaults() {
    const { contract, manifest } = this.runtime;
    const { world } = this.simulations[0];
    const image = new DepthCamera(world, manifest.camera, contract.camera, 1).image();
    drawDepth(this.healthy.querySelector("canvas"), image);
    contract.faults.forEach((fault, n) => {
      const model = makeFault(fault, this.controls.severity, contract.camera, 1);
      const frame = model.corrupt({ image, fresh: true, age: 0, invalid: 0 }, PICTURED);
      drawDepth(this.tiles[n].querySelector("canvas"), frame.image);
    });
  }

  /** Start again, with other noise, after the control step that is under way. */
  reset() {
    this.resetDue = true;
  }

  start() {
    this.resetDue = false;
    for (const simulation of this.simulations ?? []) simulation.delete();
    const seed = Math.floor(2 ** 31 * Math.random());
    const { ground, conduct } = this.scene;
    const simulate = ({ mode }) => new Simulation(this.runtime, ground, seed, mode, conduct);
    this.simulations = this.panels.map(simulate);
    this.story = new Story(ground, this.panels.length);
    this.slowed = new Set();
    this.slowUntil = 0;
    if (this.driver.driven) this.driver.stand();
    /** Whether the scene's fault is still to come. */
    this.pending = this.scene.fault !== null && !this.driver.driven;
    /** Seconds of simulation at which the story ended, and since which no robot stands. */
    this.ended = this.lying = null;
    this.broken = null;
    $("#ground").value = ground.name;
    this.view.reset(this.simulations);
    this.drawFaults();
    this.show();
  }

  get now() {
    return this.simulations[0].now;
  }

  /** Seconds of simulation for each second of the clock. */
  get pace() {
    return performance.now() < this.slowUntil ? SLOW_MOTION.pace : 1;
  }

  setGround(name) {
    this.scene.ground = this.runtime.bundle.grounds.find((ground) => ground.name === name);
    this.reset();
  }

  nextGround() {
    const { grounds } = this.runtime.bundle;
    this.setGround(grounds[(grounds.indexOf(this.scene.ground) + 1) % grounds.length].name);
  }

  setSeverity() {
    this.scene.severity = this.controls.severity;
    if (this.broken !== null) this.apply(this.broken);
    this.drawFaults();
    this.show();
  }

  /** Give both cameras a fault of the contract by its index, or none: now, and in this scene. */
  breakCamera(index) {
    const fault = index === null ? null : this.runtime.contract.faults[index];
    this.scene.fault = fault;
    this.pending = false;
    // What was to be read until now is out of date.
    this.notice = "";
    this.apply(fault);
  }

  apply(fault) {
    this.broken = fault;
    for (const { camera, now } of this.simulations) {
      if (fault) camera.break(fault, this.scene.severity, now);
      else camera.repair();
    }
    this.show();
  }

  /** Press the buttons of what is, and keep the address up to date. */
  show() {
    const { faults } = this.runtime.contract;
    const { fault, severity, modes } = this.scene;
    $("#pitch").textContent = `Both cameras break${pitch(modes)}`;
    this.tiles.forEach((button, n) => {
      press(button, faults[n] === this.broken);
      button.classList.toggle("pending", this.pending && faults[n] === fault);
      if (faults[n] === this.broken) button.scrollIntoView({ block: "nearest", inline: "nearest" });
    });
    press(this.healthy, this.broken === null);
    $("#show").hidden = !this.driver.driven;
    $("#level").textContent = `${severity} of 5${fault ? ` · ${fault.described[severity - 1]}` : ""}`;
    const link = sceneLink(this.scene, this.runtime.contract);
    // Safari refuses more than 100 changes in 30 s.
    if (link !== location.search) history.replaceState(null, "", link);
  }

  explain() {
    const hood = $("#hood");
    hood.hidden = !hood.hidden;
    expand($("#explain"), !hood.hidden);
    $(hood.hidden ? "#explain" : "#close").focus();
  }

  /** Push both robots, m/s in the world frame; by default each to its left. */
  push(velocity) {
    for (const { world } of this.simulations) {
      const { rotation } = world.pose();
      world.push(velocity ?? rotation.slice(0, 2).map((row) => SIDEWAYS * row[1]));
    }
  }

  /** Whether the scene's fault is due: both robots are the same until then. */
  get due() {
    const { obstacle } = this.scene.ground;
    if (!obstacle) return this.now >= LATER;
    const reach = this.simulations.map(({ world }) => Math.max(...world.pose().position.slice(0, 2).map(Math.abs)));
    return Math.max(...reach) >= obstacle[0] - BEFORE * SHOW.forward;
  }

  /** One control step of all robots. */
  async step() {
    this.gamepad.read();
    const { velocity } = this.driver;
    if (this.pending && this.due) {
      this.pending = false;
      this.apply(this.scene.fault);
    }
    for (const [n, simulation] of this.simulations.entries()) {
      await simulation.step(velocity);
      this.panels[n].note(simulation);
      this.story.note(n, simulation);
      if (simulation.falling && !this.slowed.has(n)) {
        this.slowed.add(n);
        this.slowUntil = performance.now() + SLOW_MOTION.milliseconds;
      }
    }
    if (this.broken && this.simulations.every(({ camera, now }) => !camera.broken(now))) this.apply(null);
    this.playAgain();
    if (this.resetDue) this.start();
  }

  /** Loop the show, and put robots back of which none stands any more. */
  playAgain() {
    const { now } = this;
    if (this.story.sentence) this.ended ??= now;
    if (this.simulations.every(({ fell }) => fell)) this.lying ??= now;
    if (!this.driver.driven) {
      if (this.ended !== null && now >= this.ended + LOOP) this.reset();
    } else if (this.lying !== null && now >= this.lying + PUT_BACK) {
      this.notify("Both fell: they are back at the start.");
      this.reset();
    }
  }

  draw(seconds) {
    this.simulations.forEach((simulation, n) => this.panels[n].update(simulation, this.story.outcome(n)));
    this.view.draw(this.simulations, seconds);
    this.pad.show(this.driver.velocity);
    const asked = velocityWords(this.driver.velocity, ASKED);
    if ($("#asked").textContent !== asked) $("#asked").textContent = asked;
    const { sentence } = this.story;
    if ($("#verdict").textContent !== sentence) $("#verdict").textContent = sentence;
  }

  /** What is going on, in a line. */
  get message() {
    if (this.notice) return this.notice;
    if (this.pace < 1) return "Slow motion";
    const { fault } = this.scene;
    const when = this.scene.ground.obstacle ? "half a second before the edge" : "soon";
    if (this.pending) return `Both cameras will fail (${fault.title.toLowerCase()}) ${when}.`;
    if (this.broken && this.now < this.story.onset + 3) return "Both cameras just failed.";
    return "";
  }
}

/** What is to be seen of two robots of these modes. */
function pitch([left, right]) {
  if (left === right) return ".";
  if (right === "memory") return "; the right robot remembers.";
  return left === "memory" ? "; the left robot remembers." : ": who stays up?";
}

function fillSelect(select, choices, onChange) {
  select.append(...choices.map(({ name, title }) => new Option(title ?? name, name)));
  select.addEventListener("change", () => onChange(select.value));
}

/** Words as a sentence. */
function asSentence(words) {
  return `${words[0].toUpperCase()}${words.slice(1)}.`;
}

const press = (button, down) => button.setAttribute("aria-pressed", String(down));
const expand = (button, open) => button.setAttribute("aria-expanded", String(open));
