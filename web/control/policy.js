// The deployed policy for one robot: three ONNX models and the memory between their ticks.
// Mirrors `src/renet/pilot/policy.py`.

import { Tensor } from "onnxruntime-web";

const tensor = (values, ...shape) => new Tensor("float32", values, [1, ...shape]);

const ESTIMATES = {
  latentOp: "next_latent_op",
  latentVp: "next_latent_vp",
  velocityOp: "velocity_op",
  velocityVp: "velocity_vp",
  heightMap: "height_map",
};

/**
 * Runs a bundle at 50 Hz; every fifth step is a 10 Hz tick of vision and both estimators.
 *
 * After a reset latents are zero, the history is filled with the first o_t and both frames with
 * the first image, as at the start of a training episode.
 */
export class Policy {
  /**
   * @param {object} manifest of the bundle.
   * @param {object} contract sizes shared with the runtime.
   * @param {object} sessions ONNX Runtime sessions `actor`, `estimator` and `vision`.
   */
  constructor(manifest, contract, sessions) {
    const { rows, columns } = contract.camera;
    this.manifest = manifest;
    this.sessions = sessions;
    this.stepsPerTick = contract.stepsPerTick;
    this.tickDt = contract.camera.tickDt;
    this.size = contract.proprioception.reduce((sum, term) => sum + term.size, 0);
    this.history = new Float32Array(manifest.history * this.size);
    this.pixels = rows * columns;
    this.frames = new Float32Array(manifest.frames * this.pixels);
    /** The two newest images that VP was given. */
    this.accepted = this.frames.slice();
    this.framesShape = [manifest.frames, rows, columns];
    this.latent = contract.latent;
    this.heightMap = this.reconstruction = null;
    this.velocityOp = this.velocityVp = new Float32Array(3);
    this.reset();
  }

  reset() {
    this.latentOp = new Float32Array(this.latent);
    this.latentVp = new Float32Array(this.latent);
    this.anomalyScore = this.varianceScore = this.surprise = this.stillness = this.mapError = 0;
    /** Evidence of the images' motion, of a vision model with a stillness. */
    this.evidence = new Float32Array(2);
    /** For how long images have been withheld, s; NaN before the first that VP was given. */
    this.imageAge = NaN;
    this.hasImage = true;
    this.blank = this.fresh = true;
    this.steps = 0;
  }

  /** Whether VP can do without an image; known once the models are loaded. */
  get remembers() {
    return this.sessions.estimator.inputNames.includes("has_image");
  }

  /** Whether the next step is a tick. */
  get due() {
    return this.steps % this.stepsPerTick === 0;
  }

  /** Push o_t onto the history. */
  remember(proprioception) {
    this.history.copyWithin(0, this.size);
    const first = this.blank ? 0 : this.history.length - this.size;
    for (let at = first; at < this.history.length; at += this.size) this.history.set(proprioception, at);
    this.blank = false;
  }

  /**
   * One tick.
   * @param {Float32Array | null} image newest, [48 * 64] in [0, 1]; null without a camera.
   * @param {Function} gate of this policy's scores: whether VP may use the image.
   * @param {boolean} fresh whether the image is new.
   */
  async tick(image, gate, fresh) {
    const unpaired = this.fresh || !this.hasImage;
    if (image) {
      this.frames.copyWithin(this.pixels, 0, this.pixels);
      this.frames.set(image, 0);
      if (this.fresh) this.frames.set(image, this.pixels);
      this.fresh = false;
    }
    const depth = tensor(this.frames, ...this.framesShape);
    this.anomalyScore = this.varianceScore = this.surprise = this.stillness = Infinity;
    if (image) {
      const seen = await this.sessions.vision.run({ depth, ...this.recollection });
      this.anomalyScore = seen.anomaly_score.data[0];
      this.varianceScore = seen.variance_score?.data[0] ?? 0;
      const ignorant = Number.isNaN(this.imageAge);
      this.surprise = ignorant ? 0 : (seen.surprise?.data[0] ?? 0);
      this.stillness = ignorant ? 0 : (seen.stillness?.data[0] ?? 0);
      // An old image stands still whatever the robot does.
      if (fresh && !ignorant && seen.next_evidence) this.evidence = seen.next_evidence.data;
      this.reconstruction = seen.reconstruction.data;
    }
    const estimates = await this.sessions.estimator.run({
      proprioception_history: tensor(this.history, this.manifest.history, this.size),
      ...(this.remembers ? this.withheld(image !== null && gate(this), unpaired) : { depth }),
      ...this.latents,
    });
    for (const [mine, name] of Object.entries(ESTIMATES)) this[mine] = estimates[name].data;
    this.mapError = estimates.map_error?.data[0] ?? 0;
  }

  /** What the robot knows before an image arrives, if the vision model asks for it. */
  get recollection() {
    const { inputNames } = this.sessions.vision;
    if (!inputNames.includes("image_age")) return {};
    const [, rows, columns] = this.framesShape;
    const evidence = inputNames.includes("evidence") && { evidence: tensor(this.evidence, 2) };
    return {
      proprioception_history: tensor(this.history, this.manifest.history, this.size),
      latent_vp: this.latents.latent_vp,
      last_image: tensor(this.accepted.slice(0, this.pixels), rows, columns),
      image_age: tensor([this.imageAge || 0], 1),
      ...evidence,
    };
  }

  /** The estimator's inputs for an image that VP may use or not. */
  withheld(hasImage, unpaired) {
    if (hasImage) {
      const newest = this.frames.subarray(0, this.pixels);
      if (unpaired) this.accepted.set(newest, this.pixels);
      else this.accepted.copyWithin(this.pixels, 0, this.pixels);
      this.accepted.set(newest, 0);
    }
    this.hasImage = hasImage;
    this.imageAge = hasImage ? 0 : this.imageAge + this.tickDt;
    return { depth: tensor(this.accepted, ...this.framesShape), has_image: tensor([Number(hasImage)], 1) };
  }

  /** Both estimators' memories, as inputs of the models. */
  get latents() {
    return { latent_op: tensor(this.latentOp, this.latent), latent_vp: tensor(this.latentVp, this.latent) };
  }

  /**
   * The action under the paper's mask; ends the control step.
   * @param {Float32Array} proprioception [45]
   * @param {boolean} vision whether VP's latent drives the actor.
   * @returns {Promise<Float32Array>} [12] policy units, clipped as in training.
   */
  async act(proprioception, vision) {
    const { action } = await this.sessions.actor.run({
      proprioception: tensor(proprioception, this.size),
      ...this.latents,
      op_mask: tensor([vision ? 0 : 1], 1),
    });
    this.steps += 1;
    const clip = this.manifest.robot.action_clip;
    return action.data.map((value) => Math.min(Math.max(value, -clip), clip));
  }

  /** Joint positions [12] in rad that an action asks for. */
  jointTarget(action) {
    const { default_position: zero, action_scale: scale } = this.manifest.robot;
    return zero.map((position, joint) => position + scale * action[joint]);
  }
}
