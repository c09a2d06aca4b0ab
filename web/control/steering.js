// Where a policy is told to go, from the velocity that a visitor asks for.
// Mirrors `src/renet/deploy/steering.py`.

/**
 * Velocity of the base in its own frame: x ahead, y left, z up.
 * @typedef {object} Velocity
 * @property {number} forward m/s; negative: backward.
 * @property {number} left m/s; negative: to the right.
 * @property {number} turnRate rad/s; positive: to the left.
 */

/**
 * What the contract knows of steering.
 * @typedef {object} Limits
 * @property {Record<keyof Velocity, [number, number]>} ranges least and greatest, m/s and rad/s.
 * @property {number} turnGain turn rate that a robot off its heading is told, rad/s per rad.
 * @property {number} maxLead farthest that the wished heading is from the robot's, rad.
 * @property {string} forwardOnly why a part of a velocity is left out.
 */

/** @type {Velocity} */
export const STILL = Object.freeze({ forward: 0, left: 0, turnRate: 0 });

/** For policies that are told (c_x, sin e, cos e), e the angle to the wished heading. */
export class HeadingSteering {
  /**
   * @param {Limits} limits of the contract.
   * @param {number} dt seconds between two commands.
   */
  constructor(limits, dt) {
    this.limits = limits;
    this.dt = dt;
    /** Why a part of the last velocity was left out; empty if none was. */
    this.refused = "";
    this.wished = 0;
  }

  /** Begin a walk in the direction in which the robot looks, rad. */
  start(heading) {
    this.wished = heading;
  }

  /**
   * @param {Velocity} velocity within the limits.
   * @param {number} heading towards which the robot looks, rad.
   * @returns {[number, number, number]} c_x in m/s, sin e, cos e.
   */
  command({ forward, left, turnRate }, heading) {
    this.refused = forward < 0 || left !== 0 ? this.limits.forwardOnly : "";
    const error = lead(this.wished + this.dt * turnRate, heading, this.limits.maxLead);
    this.wished = heading + error;
    return [Math.max(forward, 0), Math.sin(error), Math.cos(error)];
  }
}

/** For policies that are told the velocity itself; it keeps the heading on straight ways. */
export class TwistSteering {
  /** @param {Limits} limits of the contract. */
  constructor(limits) {
    this.limits = limits;
    this.refused = "";
    this.kept = 0;
  }

  /** Begin a walk in the direction in which the robot looks, rad. */
  start(heading) {
    this.kept = heading;
  }

  /**
   * @param {Velocity} velocity within the limits.
   * @param {number} heading towards which the robot looks, rad.
   * @returns {[number, number, number]} v_x, v_y in m/s, omega_z in rad/s.
   */
  command({ forward, left, turnRate }, heading) {
    const stands = forward === 0 && left === 0;
    if (turnRate !== 0 || stands) {
      this.kept = heading;
      return [forward, left, turnRate];
    }
    const { maxLead, turnGain, ranges } = this.limits;
    const error = lead(this.kept, heading, maxLead);
    this.kept = heading + error;
    return [forward, left, clamp(turnGain * error, ...ranges.turnRate)];
  }
}

/** Steerings by how a bundle's policy is told where to go. */
export const STEERINGS = { heading: HeadingSteering, twist: TwistSteering };

/**
 * A velocity within the ranges of training.
 * @param {Velocity} velocity asked for.
 * @param {Limits} limits of the contract.
 * @returns {Velocity}
 */
export function limitedVelocity({ forward, left, turnRate }, { ranges }) {
  return {
    forward: clamp(forward, ...ranges.forward),
    left: clamp(left, ...ranges.left),
    turnRate: clamp(turnRate, ...ranges.turnRate),
  };
}

/** Angle from a heading to the wished one, rad; a robot that cannot follow lags no farther. */
function lead(wished, heading, maxLead) {
  return clamp(wrap(wished - heading), -maxLead, maxLead);
}

/** An angle between -pi and pi, rad. */
function wrap(angle) {
  return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
}

function clamp(value, least, greatest) {
  return Math.min(Math.max(value, least), greatest);
}
