// Nine of the catalogue's faults; their names, levels and durations are the contract's.

/** One way a camera fails; sees every frame, also before and after the fault. */
class Fault {
  /**
   * @param {number} level strength in the fault's own unit.
   * @param {Random} random stream of its own.
   * @param {object} camera `camera` of the contract: rows, columns, range, tickDt.
   */
  constructor(level, random, camera) {
    Object.assign(this, { level, random, ...camera });
  }

  /** The delivered frame: image, fresh, age, invalid; `elapsed` < 0: not at work. */
  corrupt(frame, elapsed) {
    if (elapsed < 0) return frame;
    const image = this.spoil(frame.image, elapsed).map((value) => Math.min(Math.max(value, 0), 1));
    return { ...frame, image, invalid: Math.max(frame.invalid, this.holes) };
  }

  /** Share of pixels that the fault leaves without a measurement. */
  get holes() {
    return 0;
  }

  /** Row and column of a pixel. */
  place(pixel) {
    return [Math.floor(pixel / this.columns), pixel % this.columns];
  }
}

class Blackout extends Fault {
  spoil(image, elapsed) {
    const remaining = this.level > 0 ? Math.max(1 - elapsed / this.level, 0) : 0;
    return image.map((value) => value * remaining);
  }
}

class Gaussian extends Fault {
  spoil(image) {
    return image.map((value) => value + this.level * this.random.normal());
  }
}

class SaltAndPepper extends Fault {
  spoil(image) {
    return image.map((value) => {
      const draw = this.random.uniform();
      return draw < this.level ? Number(draw >= 0.5 * this.level) : value;
    });
  }
}

class Saturated extends Fault {
  spoil(image) {
    return image.slice().fill(1, 0, Math.round(this.level * this.rows) * this.columns);
  }
}

/** A rectangle at a random place, drawn once. */
class Occlusion extends Fault {
  constructor(...given) {
    super(...given);
    const size = [this.rows, this.columns].map((whole) => Math.round(whole * Math.sqrt(this.level)));
    const first = [this.rows, this.columns].map((whole, i) => this.random.integer(whole - size[i] + 1));
    this.covers = (pixel) => this.place(pixel).every((at, i) => at >= first[i] && at < first[i] + size[i]);
  }

  spoil(image) {
    return image.map((value, i) => (this.covers(i) ? 0.04 / this.range : value));
  }
}

/** Holes in a fixed patch whose border flickers. */
class Glare extends Fault {
  constructor(...given) {
    super(...given);
    this.field = this.smoothField(6, 8);
  }

  get holes() {
    return this.level;
  }

  spoil(image) {
    const flicker = this.smoothField(12, 16);
    const field = this.field.map((value, i) => value + 0.25 * flicker[i]);
    const limit = quantile(field, 1 - this.level);
    return image.map((value, i) => (field[i] > limit ? 0 : value));
  }

  /** Spatially correlated noise: a coarse normal grid, interpolated between its nodes. */
  smoothField(down, across) {
    const { rows, columns, random } = this;
    const coarse = Array.from({ length: (down + 1) * (across + 1) }, () => random.normal());
    return Array.from({ length: rows * columns }, (_, i) => {
      const [row, column] = this.place(i);
      const [r, c] = [(row * down) / (rows - 1), (column * across) / (columns - 1)];
      const [r0, c0] = [Math.min(Math.floor(r), down - 1), Math.min(Math.floor(c), across - 1)];
      const node = (below, right) => coarse[(r0 + below) * (across + 1) + c0 + right];
      return mix(mix(node(0, 0), node(0, 1), c - c0), mix(node(1, 0), node(1, 1), c - c0), r - r0);
    });
  }
}

class Frozen extends Fault {
  corrupt(frame, elapsed) {
    if (elapsed < 0 || !this.last) this.last = frame.image;
    return { ...frame, image: this.last };
  }
}

/** Some ticks bring no new frame: the last one is kept and ages. */
class Dropped extends Fault {
  corrupt(frame, elapsed) {
    this.held ??= frame;
    const lost = elapsed >= 0 && this.loses();
    this.held = lost ? { ...this.held, fresh: false, age: this.held.age + this.tickDt } : frame;
    return this.held;
  }

  loses() {
    return this.random.uniform() < this.level;
  }
}

class Unplugged extends Dropped {
  loses() {
    return true;
  }
}

/** Classes by their names in the catalogue. */
export const FAULTS = {
  blackout: Blackout,
  gaussian: Gaussian,
  salt_and_pepper: SaltAndPepper,
  occlusion: Occlusion,
  glare: Glare,
  saturated: Saturated,
  frozen: Frozen,
  dropped: Dropped,
  unplugged: Unplugged,
};

function mix(a, b, share) {
  return a * (1 - share) + b * share;
}

/** As numpy.quantile: linear between the two nearest ranks. */
function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  const at = share * (sorted.length - 1);
  const low = Math.floor(at);
  return mix(sorted[low], sorted[Math.min(low + 1, sorted.length - 1)], at - low);
}
