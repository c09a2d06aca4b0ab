// Which images VP gets, and whether VP or OP drives: monitors, memory, the paper's low-pass filter,
// and a dwell before vision returns. The contract says which monitors, with which thresholds.
// Mirrors `src/renet/selector/selector.py` and `monitors.py`.

/** How suspicious vision is, larger is worse; each is a function made anew for every selector. */
const SCORES = {
  reconstruction: () => (seen) => seen.anomalyScore,
  variance: () => (seen) => seen.varianceScore,
  surprise: () => (seen) => seen.surprise,
  stillness: () => (seen) => seen.stillness,
  frame_age: () => (seen) => seen.age,
  invalid_fraction: () => (seen) => seen.invalid,
  disagreement: () => (seen) => Math.hypot(...seen.velocityOp.map((v, i) => v - seen.velocityVp[i])),
  duplicate: equalInARow,
  partly_frozen: partlyEqualInARow,
  uniformity: () => oncePerImage((image) => -standardDeviation(image)),
  nearness: coveredInARow,
  map_error: () => (seen) => seen.mapError,
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

/** How many images arrived in a row that are equal in part, as the contract says. */
function partlyEqualInARow({ patch, frozenPatches, camera }) {
  let last = null;
  let run = 0;
  return ({ image, fresh }) => {
    if (fresh) {
      const frozen = last && countFrozenPatches(image, last, patch, camera.columns) >= frozenPatches;
      run = frozen ? run + 1 : 1;
      last = image;
    }
    return run;
  };
}

/** How many square patches show again what they showed before; those of one depth do not count. */
function countFrozenPatches(image, last, side, columns) {
  let frozen = 0;
  for (let row = 0; row < image.length / columns; row += side) {
    for (let column = 0; column < columns; column += side) {
      const corner = row * columns + column;
      let varied = false;
      let unchanged = true;
      for (let k = 0; k < side * side && unchanged; k++) {
        const pixel = corner + Math.floor(k / side) * columns + (k % side);
        varied ||= image[pixel] !== image[corner];
        unchanged = image[pixel] === last[pixel];
      }
      if (varied && unchanged) frozen++;
    }
  }
  return frozen;
}

/** How many images arrived in a row that the contract calls covered. */
function coveredInARow({ near, covered }) {
  let run = 0;
  return ({ image, fresh }) => {
    if (fresh) run = image.filter((value) => value < near).length > covered * image.length ? run + 1 : 0;
    return run;
  };
}

function oncePerImage(judge) {
  let last = null;
  let score = 0;
  return ({ image }) => {
    if (image !== last) [last, score] = [image, judge(image)];
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
   * @param {object} spec one of a bundle's `selectors` in the contract.
   * @param {object} contract visionThreshold, near, covered, patch, frozenPatches, camera, steady, agrees.
   */
  constructor(spec, contract) {
    Object.assign(this, spec, { contract });
    this.lateness = this.monitors.find(({ name }) => name === "frame_age")?.reason ?? "";
    this.surprisingFrom = this.monitors.find(({ name }) => name === "surprise")?.threshold ?? Infinity;
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
    this.steady = this.contract.steady;
    this.isNew = false;
    this.surprised = this.liedTo = false;
    this.periods = null;
    this.goodSince = 0;
    this.lastGood = this.returned = -Infinity;
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
    const before = this.monitors.map(({ ofImage, output }) => ofImage && !output);
    const late = this.monitors.some(({ name, threshold }) => name === "frame_age" && seen.age >= threshold);
    this.steady = late ? 0 : this.steady + Number(seen.fresh);
    this.isNew = seen.fresh;
    const fine = this.judge(seen, before).every(Boolean) && this.steady >= this.contract.steady;
    this.looked = true;
    if (!this.longestMemory) return () => true;
    const judged = this.monitors.filter(({ output }) => output);
    return (scores) => fine && seen.fresh && judged.every(({ output, threshold }) => scores[output] < threshold);
  }

  /** Whether each monitor of a subset finds its score below its threshold. */
  judge(seen, subset = this.monitors) {
    return this.scores.map((score, i) => !subset[i] || score(seen) < this.monitors[i].threshold);
  }

  /**
   * Take what is known of vision at one moment.
   * @param {object} seen anomalyScore, varianceScore, surprise, stillness, image (a new array whenever one
   *   arrives), fresh, age, invalid, velocityOp, velocityVp, hasImage, mapError.
   * @param {number} now seconds.
   * @returns {boolean} whether to use vision.
   */
  update(seen, now) {
    const verdicts = this.judge({ ...seen, fresh: seen.fresh && !this.looked });
    if (this.looked) this.heedSurprise(seen);
    this.looked = false;
    const due = this.due(now);
    if (due === 0) return this.vision;
    const [good, healthy] = this.weigh(verdicts, seen, now);
    const goal = Number(healthy);
    this.probability = goal + (1 - this.gamma) ** due * (this.probability - goal);
    const likely = this.probability > this.contract.visionThreshold;
    this.goodSince = good && healthy ? Math.min(this.goodSince, now) : Infinity;
    const dwelt = now - this.goodSince >= this.dwell - 1e-9;
    const rested = now - this.returned >= this.betweenReturns - 1e-9;
    const leaving = this.vision && !likely;
    if (leaving) this.vision = false;
    else if (!this.vision && likely && dwelt && rested) {
      this.vision = true;
      this.returned = now;
    }
    if (this.vision && good) this.reason = "";
    const ceasing = leaving || (this.longestMemory > 0 && !good && !this.reason);
    // The first withheld image gave the reason.
    const objection = verdicts.findIndex((fine, i) => !fine && !(this.reason && this.monitors[i].ofImage));
    if (ceasing && !(good && healthy)) {
      if (objection >= 0) this.reason = this.monitors[objection].reason;
      // No monitor objects to an image that is withheld after a late one.
      else if (this.steady < this.contract.steady) this.reason ||= this.lateness;
    }
    // What spoilt the images is no news: that it lasts ends the memory.
    const expired = Number.isFinite(this.withoutImage) && this.withoutImage > this.longestMemory;
    if (leaving && this.longestMemory && expired) {
      this.reason += ` for ${this.longestMemory} s, as long as it remembers`;
    }
    return this.vision;
  }

  /** After two surprising images in a row, wait for good ones; an old image surprises anyway. */
  heedSurprise(seen) {
    if (!this.isNew) return;
    const surprising = seen.surprise >= this.surprisingFrom;
    this.liedTo ||= surprising && this.surprised;
    this.surprised = surprising;
    const disagrees = seen.surprise >= this.contract.agrees * this.surprisingFrom;
    if (this.liedTo && disagrees) this.steady = 0;
    this.liedTo &&= this.steady < this.contract.steady;
  }

  /** Whether VP has a good image, and whether it may drive. */
  weigh(verdicts, seen, now) {
    if (!this.longestMemory) return Array(2).fill(verdicts.every(Boolean));
    // Who has seen nothing remembers nothing.
    if (seen.hasImage) this.lastGood = now;
    this.withoutImage = now - this.lastGood;
    const remembered = this.withoutImage <= this.longestMemory;
    const agreed = verdicts.every((ok, i) => ok || this.monitors[i].ofImage);
    return [seen.hasImage, remembered && agreed];
  }

  /** Filter updates due since the last call, at multiples of their period. */
  due(now) {
    const ticks = now * this.rate;
    const last = this.periods ?? Math.ceil(ticks - 1e-4) - 1;
    this.periods = Math.max(last, Math.floor(ticks + 1e-4));
    return this.periods - last;
  }
}
