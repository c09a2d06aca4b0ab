// Fourteen of the catalogue's faults; their names, levels and durations are the contract's.

const STREAK = [16, 4];
/** Rows and columns of a lamp's mirror image in the floor. */

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
}

/** A fault that spoils each image for itself, by a function that is made anew for each camera. */
const imageFault = (makeSpoil) =>
  class extends Fault {
    spoil = makeSpoil(this);

    /** The delivered frame: image, fresh, age, invalid; `elapsed` < 0: not at work. */
    corrupt(frame, elapsed) {
      if (elapsed < 0) return frame;
      const spoilt = this.spoil(frame.image, elapsed);
      const holes = spoilt.filter(Number.isNaN).length / spoilt.length;
      const image = spoilt.map((value) => Math.min(Math.max(value || 0, 0), 1));
      return { ...frame, image, invalid: Math.max(frame.invalid, holes) };
    }
  };

/** A rectangle at a random place, drawn once. */
function occlusion({ level, random, rows, columns, range }) {
  const [height, width] = [rows, columns].map((whole) => Math.round(whole * Math.sqrt(level)));
  const [top, left] = [rows - height, columns - width].map((room) => Math.floor((room + 1) * random.uniform()));
  return (image) =>
    image.map((value, i) => {
      const [row, column] = [Math.floor(i / columns) - top, (i % columns) - left];
      return row >= 0 && row < height && column >= 0 && column < width ? 0.04 / range : value;
    });
}

/** Holes in a fixed patch whose border flickers. */
function glare(fault) {
  const patch = smoothField(fault, 6, 8);
  return (image) => {
    const flicker = smoothField(fault, 12, 16);
    const field = patch.map((value, i) => value + 0.25 * flicker[i]);
    const limit = quantile(field, 1 - fault.level);
    return image.map((value, i) => (field[i] > limit ? NaN : value));
  };
}

/** Spatially correlated noise: a coarse normal grid, interpolated between its nodes. */
function smoothField({ rows, columns, random }, down, across) {
  const coarse = Array.from({ length: (down + 1) * (across + 1) }, () => random.normal());
  return Array.from({ length: rows * columns }, (_, i) => {
    const [r, c] = [(Math.floor(i / columns) * down) / (rows - 1), ((i % columns) * across) / (columns - 1)];
    const [r0, c0] = [Math.min(Math.floor(r), down - 1), Math.min(Math.floor(c), across - 1)];
    const node = (below, right) => coarse[(r0 + below) * (across + 1) + c0 + right];
    return mix(mix(node(0, 0), node(0, 1), c - c0), mix(node(1, 0), node(1, 1), c - c0), r - r0);
  });
}

/** Depths grow or shrink by `level` % a second, to double or half at most. */
function gainDrift({ level, random }) {
  const direction = random.uniform() < 0.5 ? -1 : 1;
  return (image, elapsed) => {
    const gain = Math.min((1 + level / 100) ** elapsed, 2) ** direction;
    return image.map((value) => value * gain);
  };
}

/** Streaks of farthest depth that begin where the floor does, and sway. */
function floorReflection({ level, random, rows, columns }) {
  const [height, width] = STREAK;
  const places = Array.from({ length: level }, () => random.uniform() * (columns - width));
  return (image, elapsed) => {
    const spoilt = image.slice();
    const sway = 4 * Math.sin((2 * Math.PI * elapsed) / 3);
    for (const place of places) {
      const left = Math.floor(Math.min(Math.max(place + sway, 0), columns - width));
      const strip = (row) => image.subarray(row * columns + left, row * columns + left + width);
      let first = 0;
      while (first < rows && strip(first).reduce((sum, value) => sum + value, 0) / width >= 0.97) first++;
      for (let row = first; row < Math.min(first + height, rows); row++) {
        spoilt.fill(1, row * columns + left, row * columns + left + width);
      }
    }
    return spoilt;
  };
}

/** A band of rows keeps what it showed before the fault. */
class HalfFrozen extends Fault {
  constructor(...given) {
    super(...given);
    const height = Math.round(this.level * this.rows);
    const top = Math.floor((this.rows - height + 1) * this.random.uniform());
    this.band = [top * this.columns, (top + height) * this.columns];
  }

  corrupt(frame, elapsed) {
    if (elapsed < 0 || !this.last) this.last = frame.image;
    if (elapsed < 0) return frame;
    const image = frame.image.slice();
    image.set(this.last.subarray(...this.band), this.band[0]);
    return { ...frame, image };
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
  blackout: imageFault(({ level }) => (image, elapsed) => {
    const remaining = level > 0 ? Math.max(1 - elapsed / level, 0) : 0;
    return image.map((value) => value * remaining);
  }),
  gaussian: imageFault(({ level, random }) => (image) => image.map((value) => value + level * random.normal())),
  salt_and_pepper: imageFault(({ level, random }) => (image) =>
    image.map((value) => {
      const draw = random.uniform();
      return draw < level ? Number(draw >= 0.5 * level) : value;
    }),
  ),
  occlusion: imageFault(occlusion),
  glare: imageFault(glare),
  saturated: imageFault(({ level, rows, columns }) => (image) =>
    image.slice().fill(1, 0, Math.round(level * rows) * columns),
  ),
  frozen: Frozen,
  dropped: Dropped,
  unplugged: Unplugged,
  mirrored: imageFault(({ columns }) => (image) =>
    image.map((_, i) => image[i + columns - 1 - 2 * (i % columns)]),
  ),
  half_frozen: HalfFrozen,
  gain_drift: imageFault(gainDrift),
  wrap_around: imageFault(({ level, range }) => (image) =>
    image.map((value) => (value < 1 ? value % (level / range) : value)),
  ),
  floor_reflection: imageFault(floorReflection),
};

const mix = (a, b, share) => a * (1 - share) + b * share;

/** As numpy.quantile: linear between the two nearest ranks. */
function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  const at = share * (sorted.length - 1);
  const low = Math.floor(at);
  return mix(sorted[low], sorted[Math.min(low + 1, sorted.length - 1)], at - low);
}
