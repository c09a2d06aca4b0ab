// Keys, buttons and the slider, by which a visitor asks for something.

const $ = (selector) => document.querySelector(selector);

/** Tells the page and its driver what the visitor asks for. */
export class Controls {
  /** @param {import("../page.js").Page} page */
  constructor(page) {
    this.page = page;
    this.severitySlider = $("#severity");
    this.bindKeys();
    $("#push").addEventListener("click", () => page.push());
    $("#reset").addEventListener("click", () => page.reset());
    $("#stop").addEventListener("click", () => page.driver.press(" "));
    $("#show").addEventListener("click", () => page.giveBack());
    this.severitySlider.addEventListener("input", () => page.setSeverity());
  }

  /** 1 to 5. */
  get severity() {
    return Number(this.severitySlider.value);
  }

  setSeverity(value) {
    this.severitySlider.value = value;
    this.page.setSeverity();
  }

  bindKeys() {
    const { page } = this;
    const once = {
      p: () => page.push(),
      r: () => page.reset(),
      h: () => page.breakCamera(null),
      t: () => page.nextGround(),
      m: () => chooseNext(page.panels[1].select),
      u: () => chooseNext($("#unseen")),
      i: () => page.explain(),
      "+": () => this.setSeverity(this.severity + 1),
      "=": () => this.setSeverity(this.severity + 1),
      "-": () => this.setSeverity(this.severity - 1),
    };
    const repeats = ["+", "=", "-"];
    // Some keys belong to a field that was reached with Tab; whoever clicked one drives on.
    let clicked = false;
    const belongs = ({ target, key }) => {
      if (clicked) return false;
      if (key.startsWith("Arrow")) return target.matches("input, select");
      return key === " " && target.matches("button, input, select");
    };
    addEventListener("pointerdown", () => (clicked = true), true);
    addEventListener("keydown", (event) => {
      if (event.key === "Tab") clicked = false;
      if (event.ctrlKey || event.metaKey || event.altKey || belongs(event)) return;
      const key = nameOf(event);
      if (page.driver.press(key)) {
        event.preventDefault();
        return;
      }
      const breaks = /^[1-9]$/.test(key);
      if (!breaks && !(key in once)) return;
      event.preventDefault();
      if (event.repeat && !repeats.includes(key)) return;
      if (breaks) page.breakCamera(Number(key) - 1);
      else once[key]();
    });
    addEventListener("keyup", (event) => {
      page.driver.release(nameOf(event));
      // Firefox presses a button that was clicked when a space ends.
      if (event.key === " " && !belongs(event)) event.preventDefault();
    });
    addEventListener("blur", () => page.driver.letGo());
  }
}

/** Name of a key, in lower case; a letter of another script is the Latin one in its place. */
function nameOf({ key, code }) {
  const foreign = /^\p{Letter}$/u.test(key) && !/^\p{Script=Latin}$/u.test(key);
  const place = foreign ? /^Key([A-Z])$/.exec(code) : null;
  return (place ? place[1] : key).toLowerCase();
}

/** Choose the next option, as the visitor would. */
function chooseNext(select) {
  select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
  select.dispatchEvent(new Event("change"));
}
