// What the visitor asks for: keys, buttons and sliders.

const TURN_RATE = 0.8;
/** rad/s while a key is held. */

const $ = (selector) => document.querySelector(selector);

/** Speed and heading that are asked for; everything else is told to `handlers`. */
export class Controls {
  /** @param {object} handlers push, reset, breakCamera(index or null), severity, and so on. */
  constructor(handlers) {
    this.handlers = handlers;
    this.held = new Set();
    this.turn = 0;
    this.speedSlider = $("#speed");
    this.severitySlider = $("#severity");
    this.bindKeys();
    $("#push").addEventListener("click", handlers.push);
    $("#reset").addEventListener("click", handlers.reset);
    this.speedSlider.addEventListener("input", () => this.setSpeed(Number(this.speedSlider.value)));
    this.severitySlider.addEventListener("input", handlers.severity);
    this.setSpeed(Number(this.speedSlider.value));
  }

  get severity() {
    return Number(this.severitySlider.value);
  }

  /** Called once a control step of `dt` seconds; returns speed and the sum of all turns. */
  command(dt) {
    const side = Number(this.held.has("left")) - Number(this.held.has("right"));
    this.turn += side * TURN_RATE * dt;
    return { speed: this.speed, turn: this.turn };
  }

  setSpeed(value) {
    this.speed = Math.min(Math.max(value, 0), 1);
    this.speedSlider.value = this.speed;
    $("#speed-value").textContent = `${this.speed.toFixed(1)} m/s`;
  }

  setSeverity(value) {
    this.severitySlider.value = value;
    this.handlers.severity();
  }

  bindKeys() {
    const { handlers } = this;
    const once = {
      w: () => this.setSpeed(this.speed + 0.1),
      s: () => this.setSpeed(this.speed - 0.1),
      p: handlers.push,
      r: handlers.reset,
      h: () => handlers.breakCamera(null),
      t: handlers.nextGround,
      m: handlers.nextMode,
      l: handlers.nextRule,
      i: handlers.explain,
      "+": () => this.setSeverity(this.severity + 1),
      "-": () => this.setSeverity(this.severity - 1),
    };
    const names = { arrowup: "w", arrowdown: "s", arrowleft: "a", arrowright: "d", "=": "+" };
    const sides = { a: "left", d: "right" };
    // Arrows belong to a field that was reached with Tab; whoever clicked one drives on.
    let clicked = false;
    addEventListener("pointerdown", () => (clicked = true), true);
    addEventListener("keydown", (event) => {
      if (event.key === "Tab") clicked = false;
      const inField = !clicked && event.target.matches("input, select");
      const given = event.key.toLowerCase();
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (inField && given.startsWith("arrow")) return;
      const key = names[given] ?? given;
      if (sides[key]) this.held.add(sides[key]);
      else if (once[key] && (!event.repeat || "ws+-".includes(key))) once[key]();
      else if (/^[1-9]$/.test(key) && !event.repeat) handlers.breakCamera(Number(key) - 1);
      else return;
      event.preventDefault();
    });
    addEventListener("keyup", (event) => {
      const key = event.key.toLowerCase();
      this.held.delete(sides[names[key] ?? key]);
    });
    addEventListener("blur", () => this.held.clear());
  }
}
