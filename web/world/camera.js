// A simulated depth camera: MuJoCo's ray caster, the training camera's geometry and noise.

import { FAULTS } from "./faults.js";
import { Random } from "./random.js";

/** Looks at the terrain from the robot's base, at the camera's rate on the robot's clock. */
export class DepthCamera {
  /**
   * @param {object} world a `World`.
   * @param {object} spec `camera` of the bundle's manifest.
   * @param {object} contract `camera` of the contract.
   * @param {number} seed of its noise and of its faults.
   */
  constructor(world, spec, contract, seed) {
    Object.assign(this, { world, spec, contract, seed });
    this.random = new Random(seed);
    this.rays = pixelRays(spec);
    const length = (_, n) => Math.hypot(...this.rays.subarray(3 * n, 3 * n + 3));
    this.lengths = Float64Array.from({ length: spec.width * spec.height }, length);
    this.directions = new Float64Array(this.rays.length);
    this.due = 0;
    this.frame = null;
    this.fault = null;
  }

  /** Break the camera: a fault of the contract at a severity of 1 to 5. */
  break(fault, severity, now) {
    const lasts = fault.lasts[severity - 1] ?? Infinity;
    const model = makeFault(fault, severity, this.contract, this.seed);
    // As if the fault had been there all the time, not yet at work.
    if (this.healthy) model.corrupt(this.healthy, -1);
    this.fault = { name: fault.name, severity, model, onset: now, lasts };
  }

  /** Repair the camera. */
  repair() {
    this.fault = null;
  }

  /** Whether a fault is at work. */
  broken(now) {
    return this.fault !== null && now - this.fault.onset < this.fault.lasts - 1e-6;
  }

  /** Newest frame; casts rays when an image is due. */
  latest(now) {
    if (this.frame && now < this.due - 1e-6) return this.frame;
    const period = 1 / this.spec.rate_hz;
    // After a pause the beat begins anew: images that were left out are not made up for.
    this.due = (now < this.due + period ? this.due : now) + period;
    this.healthy = { image: this.image(), fresh: true, age: 0, invalid: 0 };
    const { image, invalid, age, fresh } = this.spoilt(this.healthy, now);
    if (fresh || !this.frame) this.frame = { image, invalid, time: now - age };
    return this.frame;
  }

  spoilt(frame, now) {
    if (this.fault === null) return frame;
    const elapsed = this.broken(now) ? now - this.fault.onset : -1;
    const spoilt = this.fault.model.corrupt(frame, elapsed);
    return elapsed < 0 ? frame : spoilt;
  }

  /** What a healthy camera delivers, in [0, 1]. */
  image() {
    const { range, noise_std = 0.1 } = this.spec; // Older manifests do not say.
    return Float32Array.from(this.depth(), (depth) => {
      const deviation = Math.hypot(this.contract.relativeStd * depth, noise_std);
      return Math.min(Math.max((depth + deviation * this.random.normal()) / range, 0), 1);
    });
  }

  /** Planar metres [48 * 64] without noise, capped at the range. */
  depth() {
    const { position, rotation } = this.world.pose();
    const { spec, rays, lengths } = this;
    const eye = position.map((value, i) => value + dot(rotation[i], spec.position));
    const [sine, cosine] = [Math.sin(spec.pitch), Math.cos(spec.pitch)];
    // The mount looks down by the pitch.
    const mount = rotation.map(([x, y, z]) => [cosine * x - sine * z, y, sine * x + cosine * z]);
    for (let n = 0; n < lengths.length; n += 1) {
      const ray = rays.subarray(3 * n, 3 * n + 3);
      for (let i = 0; i < 3; i += 1) this.directions[3 * n + i] = dot(mount[i], ray) / lengths[n];
    }
    const { distance, hit } = this.world.castRays(eye, this.directions, this.contract.seenGroups);
    return lengths.map((length, n) => (hit[n] >= 0 ? Math.min(distance[n] / length, spec.range) : spec.range));
  }
}

/** A fault of the contract at a severity of 1 to 5, with random numbers of its own. */
export function makeFault({ name, levels }, severity, camera, seed) {
  return new FAULTS[name](levels[severity - 1] ?? Infinity, new Random(seed ^ 0x5eed), camera);
}

/** Directions [48 * 64 * 3] (forward, left, up) through pixel centres, forward 1, row by row. */
function pixelRays({ width, height, fx, fy, cx, cy }) {
  return Float64Array.from({ length: 3 * width * height }, (_, i) => {
    const pixel = Math.floor(i / 3);
    const [row, column] = [Math.floor(pixel / width), pixel % width];
    return [1, (cx - 0.5 - column) / fx, (cy - 0.5 - row) / fy][i % 3];
  });
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
