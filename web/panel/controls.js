// What the visitor asks for: keys, buttons and sliders.

const TURN_RATE = 0.8;
/** rad/s while a key is held. */

const $ = (selector) => document.querySelector(selector);

/** Speed and heading that are asked for; everything else is told to the page. */
export class Controls {
  constructor(page) {
    this.page = page;
    this.held = new Set();
    this.turn = 0;
    this.speedSlider = $("#speed");
    this.severitySlider = $("#severity");
    this.bindKeys();
    $("#push").addEventListener("click", () => page.push());
    $("#reset").addEventListener("click", () => page.reset());
    this.speedSlider.addEventListener("input", () => this.setSpeed(Number(this.speedSlider.value)));
    this.severitySlider.addEventListener("input", () => page.setSeverity());
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
    this.page.setSeverity();
  }

  bindKeys() {
    const { page } = this;
    const once = {
      w: () => this.setSpeed(this.speed + 0.1),
      s: () => this.setSpeed(this.speed - 0.1),
      p: () => page.push(),
      r: () => page.reset(),
      h: () => page.breakCamera(null),
      t: () => page.nextGround(),
      m: () => next(page.panels[1].mode),
      l: () => next(page.rule),
      i: () => page.explain(),
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
      else if (/^[1-9]$/.test(key) && !event.repeat) page.breakCamera(Number(key) - 1);
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

/** Choose the next option, as the visitor would. */
function next(select) {
  select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
  select.dispatchEvent(new Event("change"));
}
