// A gamepad: its left stick goes, its right one turns, as for `renet deploy --teleop joystick`.

/** Sticks of a gamepad that the browser calls standard: their axes by the component that they steer. */
const STICKS = [{ left: 0, forward: 1 }, { turnRate: 2 }];
/** Buttons that ask to stand: the lower and the right one of four. */
const STOPS = [0, 1];
const FOUND = "Gamepad: the left stick goes, the right one turns.";
const SINGLE = "Gamepad: its stick goes; A and D turn.";
const UNKNOWN = "The browser does not know this gamepad's sticks: take an Xbox or a PlayStation pad.";

/** Steers by the first gamepad with known sticks. */
export class Gamepad {
  /**
   * @param {import("./driver.js").Driver} driver
   * @param {(words: string) => void} onNotice told that a gamepad was found.
   */
  constructor(driver, onNotice) {
    this.driver = driver;
    /** Whether each stick was out of its middle when it was last read. */
    this.steers = STICKS.map(() => false);
    addEventListener("gamepadconnected", ({ gamepad }) => onNotice(greeting(gamepad)));
  }

  /** Read the gamepad; to be called in every control step, for gamepads send no events. */
  read() {
    const pad = findPad();
    this.steers = STICKS.map((axes, n) => this.readStick(pad, axes, this.steers[n]));
    if (STOPS.some((button) => pad?.buttons[button].pressed)) this.driver.press(" ");
  }

  /** Steer by a stick, which may be missing; whether it is out of its middle now, as it was `before` or not. */
  readStick(pad, axes, before) {
    const wished = {};
    for (const [component, axis] of Object.entries(axes)) {
      // Axes grow to the right and backward, components to the left and ahead.
      wished[component] = this.driver.scaled(component, -(pad?.axes[axis] ?? 0));
    }
    const steers = Object.values(wished).some((value) => value !== 0);
    if (steers) this.driver.steer(wished);
    else if (before) this.driver.leave(Object.keys(axes), false);
    return steers;
  }
}

/** The first gamepad with known sticks. */
function findPad() {
  try {
    return [...(navigator.getGamepads?.() ?? [])].find(isKnown);
  } catch {
    // A page that shows this one in a frame may forbid gamepads.
    return undefined;
  }
}

function greeting(pad) {
  if (!isKnown(pad)) return UNKNOWN;
  return pad.axes.length > STICKS[1].turnRate ? FOUND : SINGLE;
}

function isKnown(pad) {
  return pad?.mapping === "standard";
}
