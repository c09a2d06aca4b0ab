// When to trust vision: monitors, the paper's low-pass filter, and a dwell before vision returns.
// With the reconstruction monitor alone and no dwell it is the paper's rule (RENet, Method B).

/** Scores of one robot, larger is worse; each is a function made anew for every selector. */
const SCORES = {
  reconstruction: () => (seen) => seen.anomalyScore,
  variance: () => (seen) => seen.varianceScore ?? 0,
  frame_age: () => (seen) => seen.age,
  invalid_fraction: () => (seen) => seen.invalid,
  disagreement: () => (seen) =>
    Math.hypot(...seen.velocityOp.map((value, i) => value - seen.velocityVp[i])),
  duplicate: equalInARow,
  uniformity: () => oncePerImage((image) => -standardDeviation(image)),
  nearness: coveredInARow,
};

/** How many equal images arrived in a row. */
function equalInARow() {
  let last = null;
  let run = 0;
  return ({ image, fresh }) => {
    if (fresh) {
      run = last && image.every((value, i) => value === last[i]) ? run + 1 : 1;
      last = image;
    }
    return run;
  };
}

/** How many images arrived in a row of which hardly a pixel is farther than 10 cm. */
function coveredInARow(contract) {
  let run = 0;
  return ({ image, fresh }) => {
    const near = (value) => value < contract.near;
    if (fresh) run = image.filter(near).length > contract.covered * image.length ? run + 1 : 0;
    return run;
  };
}

function oncePerImage(judge) {
  let known = null;
  let score = 0;
  return ({ image }) => {
    if (image !== known) [known, score] = [image, judge(image)];
    return score;
  };
}

function standardDeviation(values) {
  const mean = values.reduce((sum, value) => sum + value, 0) / values.length;
  return Math.sqrt(values.reduce((sum, value) => sum + (value - mean) ** 2, 0) / values.length);
}

/** Decides whether vision (VP) or blind walking (OP) acts; its filter has a clock of its own. */
export class Selector {
  /**
   * @param {"monitors" | "paper"} kind all monitors, or the reconstruction loss against beta.
   * @param {object} spec `selector` of the bundle's manifest.
   * @param {object} contract `selector` of the contract.
   */
  constructor(kind, spec, contract) {
    const paper = kind === "paper";
    const thresholds = paper ? {} : spec.thresholds;
    /** Of the reconstruction loss. */
    this.beta = thresholds.reconstruction ?? spec.beta;
    // Unless told otherwise, the error over its predicted variance judges the same images better.
    const beta = thresholds.reconstruction ?? ("variance" in thresholds ? null : spec.beta);
    this.contract = contract;
    this.gamma = spec.gamma;
    this.rate = spec.rate_hz;
    this.dwell = paper ? 0 : contract.dwell;
    this.betweenReturns = paper ? 0 : contract.betweenReturns;
    this.monitors = contract.monitors
      .filter(({ name }) => !paper || name === "reconstruction")
      .map(({ name, reason, fallback }) => ({
        name,
        reason,
        threshold: name === "reconstruction" ? beta : thresholds[name] ?? fallback,
      }))
      .filter(({ threshold }) => threshold !== null);
    this.reset();
  }

  /** Trust vision and forget the past. */
  reset() {
    this.scores = this.monitors.map(({ name }) => SCORES[name](this.contract));
    this.probability = 1;
    this.vision = true;
    this.reason = "";
    this.start = null;
    this.healthySince = this.returned = -Infinity;
  }

  /**
   * Take what is known of vision at one moment.
   * @param {object} seen anomalyScore, image (a new array whenever one arrives), fresh, age,
   *   invalid, velocityOp, velocityVp.
   * @param {number} now seconds.
   * @returns {boolean} whether to use vision.
   */
  update(seen, now) {
    const verdicts = this.scores.map((score, i) => score(seen) < this.monitors[i].threshold);
    const due = this.due(now);
    if (due === 0) return this.vision;
    const healthy = verdicts.every(Boolean);
    const goal = Number(healthy);
    this.probability = goal + (1 - this.gamma) ** due * (this.probability - goal);
    const likely = this.probability > this.contract.visionThreshold;
    this.healthySince = healthy ? Math.min(this.healthySince, now) : Infinity;
    const rested =
      now - this.healthySince >= this.dwell - 1e-9 &&
      now - this.returned >= this.betweenReturns - 1e-9;
    if (this.vision && !likely) {
      this.vision = false;
      if (!healthy) this.reason = this.monitors[verdicts.indexOf(false)].reason;
    } else if (!this.vision && likely && rested) {
      this.vision = true;
      this.returned = now;
      this.reason = "";
    }
    return this.vision;
  }

  /** Filter updates due since the last call; the first call is one. */
  due(now) {
    if (this.start === null) [this.start, this.taken] = [now, 0];
    const elapsed = Math.floor((now - this.start) * this.rate + 1e-6) + 1;
    const due = Math.max(elapsed - this.taken, 0);
    this.taken += due;
    return due;
  }
}
