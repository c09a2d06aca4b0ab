// Two sticks on the screen, as those of a gamepad: one goes, one turns.

/** @typedef {import("../control/steering.js").Velocity} Velocity */

const TAP = 6;
/** Pixels from where a pointer went down within which it taps, and does not drag. */
/** Arrows of the stick that goes, by their class: the component and the side of each. */
const ARROWS = {
  ahead: ["forward", 1],
  back: ["forward", -1],
  left: ["left", 1],
  right: ["left", -1],
};

/** A stick that follows a pointer and springs back; after a tap the forward speed stays. */
class Stick {
  /**
   * @param {HTMLElement} element with a knob `b` in it.
   * @param {{ across: keyof Velocity, along?: keyof Velocity }} axes components to the left and ahead.
   * @param {import("./driver.js").Driver} driver
   */
  constructor(element, axes, driver) {
    this.element = element;
    this.axes = axes;
    this.driver = driver;
    this.knob = element.querySelector("b");
    this.pointer = null;
    element.addEventListener("pointerdown", (event) => {
      // The menu of another button of a mouse would keep the news that it was let go.
      if (this.pointer !== null || event.button !== 0) return;
      this.pointer = event.pointerId;
      this.from = [event.clientX, event.clientY];
      this.taps = true;
      element.setPointerCapture(event.pointerId);
      this.follow(event);
    });
    element.addEventListener("pointermove", (event) => {
      if (event.pointerId !== this.pointer) return;
      const [x, y] = this.from;
      this.taps &&= Math.hypot(event.clientX - x, event.clientY - y) <= TAP;
      this.follow(event);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      element.addEventListener(end, (event) => {
        if (event.pointerId !== this.pointer) return;
        this.pointer = null;
        driver.leave(Object.values(axes), this.taps && end === "pointerup");
      });
    }
  }

  /** Steer by where a pointer is. */
  follow({ clientX, clientY }) {
    const { left, top, width, height } = this.element.getBoundingClientRect();
    const reach = this.reach;
    const across = (left + width / 2 - clientX) / reach;
    const along = (top + height / 2 - clientY) / reach;
    const { driver, axes } = this;
    const wished = { [axes.across]: driver.scaled(axes.across, across) };
    if (axes.along) wished[axes.along] = driver.scaled(axes.along, along);
    driver.steer(wished);
  }

  /** Pixels from the middle to where a stick gives all. */
  get reach() {
    return (this.element.clientWidth - this.knob.offsetWidth) / 2;
  }

  /** Put the knob where a velocity is, whoever asks for it. */
  show(velocity) {
    const across = this.share(this.axes.across, velocity);
    const along = this.axes.along ? this.share(this.axes.along, velocity) : 0;
    this.knob.style.translate = `${-across * this.reach}px ${-along * this.reach}px`;
  }

  share(component, velocity) {
    const value = velocity[component];
    const [least, greatest] = this.driver.steering.ranges[component];
    return value > 0 ? value / greatest : -value / least;
  }
}

/** Both sticks, without the arrows that the policy cannot follow. */
export class Pad {
  /**
   * @param {HTMLElement} go goes ahead, back and sideways.
   * @param {HTMLElement} turn turns.
   * @param {import("./driver.js").Driver} driver
   */
  constructor(go, turn, driver) {
    this.sticks = [
      new Stick(go, { across: "left", along: "forward" }, driver),
      new Stick(turn, { across: "turnRate" }, driver),
    ];
    for (const [name, [component, side]] of Object.entries(ARROWS)) {
      go.querySelector(`.${name}`).hidden = !driver.offers(component, side);
    }
    if (!driver.offers("left", 1)) go.title = `Drag, or tap to go on: ahead (W, S); ${driver.steering.forwardOnly}`;
  }

  /** @param {Velocity} velocity asked for. */
  show(velocity) {
    for (const stick of this.sticks) stick.show(velocity);
  }
}
