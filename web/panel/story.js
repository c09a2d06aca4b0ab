// What becomes of the robots, in words.

import { WALKED } from "./words.js";

export const BEFORE = 0.5;
/** Seconds before an obstacle's edge, at the speed that is asked for, at which cameras break. */
const CLEAR = 0.3;
/** Metres beyond an obstacle at which the hind feet have left it, too. */
const SETTLED = 8;
/** Seconds after a fault, or of one robot alone, after which the story is told. */
const HOW = { sees: "by sight", remembers: "from memory", blind: "blind" };
const FOOLED = "on broken images";

/** Follows the robots of one scene. */
export class Story {
  /**
   * @param {object} ground one of a bundle's.
   * @param {number} robots how many there are.
   */
  constructor(ground, robots) {
    this.ground = ground;
    /** Seconds at which the cameras broke for the last time; null: not yet. */
    this.onset = null;
    this.broken = false;
    this.now = 0;
    const tale = { mode: "", distance: 0, stands: false, fell: null, done: null, state: "", how: "" };
    this.tales = Array.from({ length: robots }, () => ({ ...tale }));
  }

  /** Keep one control step of robot `n`. */
  note(n, { now, fell, state, world, camera, walked, controller: { mode } }) {
    const tale = this.tales[n];
    const [x, y] = world.pose().position;
    const reach = Math.max(Math.abs(x), Math.abs(y));
    const [first, last] = this.ground.obstacle ?? [Infinity, Infinity];
    this.now = now;
    const broken = camera.broken(now);
    // The cameras of all robots break at once.
    if (broken && !this.broken) this.onset = camera.fault.onset;
    this.broken = broken;
    tale.state = state;
    if (tale.fell !== null) return;
    // What was done is told of the mode in which it was done, whatever the visitor chooses then.
    if (fell || tale.done === null) tale.mode = mode;
    tale.distance = Math.hypot(x, y);
    tale.stands = Math.hypot(walked.forward, walked.left) < WALKED.speed;
    if (fell) tale.fell = now;
    if (reach > first && state) tale.how ||= state === "sees" && broken ? FOOLED : HOW[state];
    if (reach > last + CLEAR && state) tale.done ??= now;
  }

  /** Of robot `n`, for its half of the stage. */
  outcome(n) {
    const { fell, done, state, distance } = this.tales[n];
    const metres = `${distance.toFixed(1)} m`;
    if (fell !== null) return `Fell after ${metres}`;
    if (!state) return "Standing up";
    return done === null ? metres : `${capital(this.ground.done)} · ${metres}`;
  }

  /** What happened to all of them, once it has; empty before. */
  get sentence() {
    const ends = this.tales.map(({ fell, done }) => fell ?? done);
    const first = Math.min(...ends.map((end) => end ?? Infinity), this.onset ?? Infinity);
    if (ends.includes(null) && this.now < first + SETTLED) return "";
    return this.tales.map((tale) => `${capital(tale.mode)} ${this.verb(tale)}.`).join(" ");
  }

  verb({ fell, done, how, distance, stands }) {
    const metres = `${distance.toFixed(1)} m`;
    if (fell === null && done !== null) return `${this.ground.done} ${how}`;
    if (fell === null) return `${stands ? "stands" : "walks on"} after ${metres}`;
    const late = this.onset === null ? -1 : fell - this.onset;
    return late >= 0 ? `fell ${late.toFixed(1)} s after its camera broke` : `fell after ${metres}`;
  }
}

function capital(words) {
  return words[0].toUpperCase() + words.slice(1);
}
