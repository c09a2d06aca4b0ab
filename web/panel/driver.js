// Who steers both robots: the show, until a visitor takes over by keys, by the pad or a gamepad.

import { STILL } from "../control/steering.js";

/** @typedef {import("../control/steering.js").Velocity} Velocity */

/** @type {Velocity} */
export const SHOW = Object.freeze({ forward: 0.6, left: 0, turnRate: 0 });
/** Components of a velocity, in the order in which the contract's keys count them. */
const COMPONENTS = ["forward", "left", "turnRate"];
const STEP = 0.1;
/** m/s that a key adds to the forward speed, which stays. */
const HELD = { left: 0.4, turnRate: 0.8 };
/** m/s and rad/s while a key is held. */
const DEAD_ZONE = 0.1;
/** Share of its way that a stick must leave its middle to steer. */
const ALIASES = { arrowup: "w", arrowdown: "s", arrowleft: "a", arrowright: "d", q: "j", e: "l" };
/** Keys that do what keys of `renet deploy` do: browsers have arrows, and know when a key is let go. */

/** The velocity that is asked for. */
export class Driver {
  /**
   * @param {"twist" | "heading"} told how the bundle's policy is told where to go.
   * @param {import("../control/steering.js").Limits & { keys: object, standKey: string }} steering
   * @param {(why: string) => void} onRefusal told what the policy cannot do.
   * @param {() => void} onTakeOver told that the visitor steers from now on.
   */
  constructor(told, steering, onRefusal, onTakeOver) {
    this.told = told;
    this.steering = steering;
    this.onRefusal = onRefusal;
    this.onTakeOver = onTakeOver;
    /** Keys that are held. */
    this.held = new Set();
    /** Components that a pointer or a gamepad holds, m/s and rad/s. */
    this.pad = {};
    this.giveBack();
  }

  /** Let the show steer. */
  giveBack() {
    this.stand();
    /** Whether the visitor steers. */
    this.driven = false;
    this.forward = SHOW.forward;
  }

  /** Ask the robots to stand where they are. */
  stand() {
    this.forward = 0;
    this.letGo();
  }

  /** Forget what is held; the forward speed stays. */
  letGo() {
    this.held.clear();
    this.pad = {};
  }

  /** @returns {Velocity} asked for now. */
  get velocity() {
    if (!this.driven) return SHOW;
    const keys = {
      forward: this.forward,
      left: HELD.left * this.heldSide("left"),
      turnRate: HELD.turnRate * this.heldSide("turnRate"),
    };
    return { ...STILL, ...keys, ...this.pad };
  }

  /** Whether the policy can follow a component to a side, 1 or -1. */
  offers(component, side) {
    if (this.told === "twist" || component === "turnRate") return true;
    return component === "forward" && side > 0;
  }

  /** Value of a component, m/s or rad/s, for a share of a stick's way to a side, -1 to 1. */
  scaled(component, share) {
    if (Math.abs(share) < DEAD_ZONE) return 0;
    const [least, greatest] = this.steering.ranges[component];
    return share > 0 ? Math.min(share, 1) * greatest : -Math.max(share, -1) * least;
  }

  /**
   * Take a key that goes down.
   * @param {string} given its name, in lower case.
   * @returns {boolean} whether it steers.
   */
  press(given) {
    const key = ALIASES[given] ?? given;
    if (key === " " || key === this.steering.standKey) {
      this.takeOver();
      this.stand();
      return true;
    }
    if (!(key in this.steering.keys)) return false;
    const [number, side] = this.steering.keys[key];
    const component = COMPONENTS[number];
    this.takeOver();
    const brakes = component === "forward" && side < 0 && this.forward > 0;
    if (!brakes && !this.offers(component, side)) this.onRefusal(this.steering.forwardOnly);
    else if (component === "forward") this.change(side);
    else this.held.add(key);
    return true;
  }

  /** Take a key that goes up. */
  release(given) {
    this.held.delete(ALIASES[given] ?? given);
  }

  /**
   * Take components that a pointer holds on the pad, or the sticks of a gamepad.
   * @param {Partial<Velocity>} wished
   */
  steer(wished) {
    this.takeOver();
    const asked = {};
    for (const [component, value] of Object.entries(wished)) {
      asked[component] = this.offers(component, Math.sign(value)) ? value : 0;
    }
    Object.assign(this.pad, asked);
    // A stick springs back: who lets it go wants to stand.
    if ("forward" in wished) this.forward = 0;
    // A thumb that goes ahead is never quite straight: no word of the rest.
    const wants = Object.values(wished).some(Boolean);
    const gets = Object.values(asked).some(Boolean);
    if (wants && !gets) this.onRefusal(this.steering.forwardOnly);
  }

  /**
   * Take the news that a pointer or a gamepad let components go.
   * @param {string[]} components that it held.
   * @param {boolean} keeps whether the forward speed stays, as it does after a key, if it was held.
   */
  leave(components, keeps) {
    if (keeps && components.includes("forward")) this.forward = this.pad.forward ?? this.forward;
    for (const component of components) delete this.pad[component];
  }

  takeOver() {
    if (this.driven) return;
    this.driven = true;
    this.onTakeOver();
  }

  /** Change the forward speed by a step. */
  change(side) {
    const [least, greatest] = this.steering.ranges.forward;
    const slowest = this.offers("forward", -1) ? least : 0;
    const steps = Math.round(this.forward / STEP) + side;
    this.forward = Math.min(Math.max(steps * STEP, slowest), greatest);
  }

  /** 1, 0 or -1: to which side held keys move a component. */
  heldSide(component) {
    let sum = 0;
    for (const key of this.held) {
      const [number, side] = this.steering.keys[key];
      if (COMPONENTS[number] === component) sum += side;
    }
    return Math.sign(sum);
  }
}
