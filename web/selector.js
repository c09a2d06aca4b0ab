// Which images VP gets, and whether VP or OP drives: monitors, memory, the paper's low-pass filter,
// and a dwell before vision returns. With the reconstruction monitor alone, no dwell and no memory
// it is the paper's rule (RENet, Method B).

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
  map_error: () => (seen) => seen.mapError,
};
/** What the monitors of the vision model's outputs judge. */
const OUTPUTS = { variance_score: "varianceScore", anomaly_score: "anomalyScore" };

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

/** How many images arrived in a row of which more than two fifths are nearer than 10 cm. */
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

/** Decides which images VP gets and whether VP or OP drives; its filter has a clock of its own. */
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
    this.longestMemory = paper ? 0 : spec.longest_memory;
    this.monitors = contract.monitors
      .filter(({ name }) => !paper || name === "reconstruction")
      .map(({ name, fallback, ...monitor }) => ({
        ...monitor,
        name,
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
    this.withoutImage = 0;
    this.reason = "";
    this.looked = false;
    this.start = null;
    this.goodSince = this.lastGood = this.returned = -Infinity;
  }

  /** "sees", "remembers" (VP drives without images) or "blind" (OP drives). */
  get state() {
    if (!this.vision) return "blind";
    return this.withoutImage > 0 ? "remembers" : "sees";
  }

  /**
   * Judge a tick's image before the vision model runs; called once in every tick.
   * @param {object} seen image, fresh, age, invalid.
   * @returns {Function} of the vision model's scores: whether VP may use the image.
   */
  look(seen) {
    const verdicts = this.judge(seen);
    this.looked = true;
    if (!this.longestMemory) return () => true;
    const { monitors } = this;
    const acceptable = seen.fresh && verdicts.every((ok, i) => ok || !monitors[i].ofImage || monitors[i].output);
    const judged = monitors.filter(({ output }) => output);
    return (scores) =>
      acceptable && judged.every(({ output, threshold }) => scores[OUTPUTS[output]] < threshold);
  }

  judge(seen) {
    return this.scores.map((score, i) => score(seen) < this.monitors[i].threshold);
  }

  /**
   * Take what is known of vision at one moment.
   * @param {object} seen anomalyScore, image (a new array whenever one arrives), fresh, age,
   *   invalid, velocityOp, velocityVp, hasImage, mapError.
   * @param {number} now seconds.
   * @returns {boolean} whether to use vision.
   */
  update(seen, now) {
    const verdicts = this.judge({ ...seen, fresh: seen.fresh && !this.looked });
    this.looked = false;
    const due = this.due(now);
    if (due === 0) return this.vision;
    const [good, healthy] = this.weigh(verdicts, seen, now);
    const goal = Number(healthy);
    this.probability = goal + (1 - this.gamma) ** due * (this.probability - goal);
    const likely = this.probability > this.contract.visionThreshold;
    this.goodSince = good && healthy ? Math.min(this.goodSince, now) : Infinity;
    const rested =
      now - this.goodSince >= this.dwell - 1e-9 &&
      now - this.returned >= this.betweenReturns - 1e-9;
    const leaving = this.vision && !likely;
    if (leaving) this.vision = false;
    else if (!this.vision && likely && rested) {
      this.vision = true;
      this.returned = now;
    }
    if (this.vision && good) this.reason = "";
    const ceasing = leaving || (this.longestMemory && !good && !this.reason);
    const objection = verdicts.indexOf(false);
    if (ceasing && !(good && healthy) && objection >= 0) {
      this.reason = this.monitors[objection].reason;
    }
    return this.vision;
  }

  /** Whether VP has a good image, and whether it may drive. */
  weigh(verdicts, seen, now) {
    if (!this.longestMemory) {
      const healthy = verdicts.every(Boolean);
      return [healthy, healthy];
    }
    // Who has seen nothing remembers nothing.
    if (seen.hasImage) this.lastGood = now;
    this.withoutImage = now - this.lastGood;
    const remembered = this.withoutImage <= this.longestMemory;
    const agreed = verdicts.every((ok, i) => ok || this.monitors[i].ofImage);
    return [seen.hasImage, remembered && agreed];
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
