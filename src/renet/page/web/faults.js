// Every way a depth camera fails that does not need the scene: faults of the image and of time.
// Levels, names and durations come from the catalogue; a test holds the statistics to it.

const ROWS = 48;
const COLUMNS = 64;
const RANGE = 2.0;
const TICK = 0.1;

/** One way a camera fails; sees every frame, also before and after the fault. */
class Fault {
  /**
   * @param {number} level strength in the fault's own unit.
   * @param {Random} random stream of its own.
   * @param {object} contract `camera` of the contract.
   */
  constructor(level, random, contract) {
    Object.assign(this, { level, random, contract });
  }

  /** Same keys as `frame`: image, fresh, age, invalid, angularVelocity; `elapsed` < 0: not at work. */
  corrupt(frame, elapsed) {
    if (elapsed < 0) return frame;
    const image = this.spoil(frame.image, elapsed, frame).map(clip);
    return { ...frame, image, invalid: Math.max(frame.invalid, this.holes(frame.image)) };
  }

  /** Share of pixels the fault leaves without a measurement, called after `spoil`. */
  holes() {
    return 0;
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

class Blackout extends Fault {
  spoil(image, elapsed) {
    const remaining = this.level > 0 ? Math.max(1 - elapsed / this.level, 0) : 0;
    return image.map((value) => value * remaining);
  }
}

class Saturated extends Fault {
  spoil(image) {
    return image.slice().fill(1, 0, Math.round(this.level * ROWS) * COLUMNS);
  }
}

/** A pattern drawn once, when the fault is made: NaN where the image shows through. */
class FixedPattern extends Fault {
  constructor(...given) {
    super(...given);
    this.pattern = this.draw(new Float32Array(ROWS * COLUMNS).fill(NaN));
  }

  spoil(image) {
    return image.map((value, i) => (Number.isNaN(this.pattern[i]) ? value : this.pattern[i]));
  }
}

class Occlusion extends FixedPattern {
  draw(pattern) {
    const height = Math.round(ROWS * Math.sqrt(this.level));
    const width = Math.round(COLUMNS * Math.sqrt(this.level));
    const top = this.random.integer(ROWS - height + 1);
    const left = this.random.integer(COLUMNS - width + 1);
    return pattern.map((value, i) => {
      const [row, column] = place(i);
      const inside = row >= top && row < top + height && column >= left && column < left + width;
      return inside ? 0.04 / RANGE : value;
    });
  }
}

class Blobs extends FixedPattern {
  draw(pattern) {
    for (let blob = 0; blob < this.level; blob += 1) {
      const [r, c] = [this.random.uniform(0, ROWS), this.random.uniform(0, COLUMNS)];
      const radius = this.random.uniform(1, 4);
      const depth = this.random.uniform(0.03, 0.2) / RANGE;
      pattern.forEach((_, i) => {
        const [row, column] = place(i);
        if ((row - r) ** 2 + (column - c) ** 2 <= radius ** 2) pattern[i] = depth;
      });
    }
    return pattern;
  }
}

class Grass extends Fault {
  spoil(image) {
    const covered = (ROWS * (1 + this.level)) / 3;
    const blades = Array.from({ length: COLUMNS }, () => ({
      present: this.random.uniform() < 0.25 + 0.7 * this.level,
      tip: ROWS - covered * this.random.uniform(0.6, 1),
      depth: this.random.uniform(0.2, 0.6) / RANGE,
    }));
    return image.map((value, i) => {
      const [row, column] = place(i);
      const { present, tip, depth } = blades[column];
      return present && row >= tip ? Math.min(value, depth) : value;
    });
  }
}

class Glare extends Fault {
  constructor(...given) {
    super(...given);
    this.field = smoothField(this.random, 6, 8);
  }

  /** Where the holes are in the next frame: a fixed patch whose border flickers. */
  mask() {
    const flicker = smoothField(this.random, 12, 16);
    const field = this.field.map((value, i) => value + 0.25 * flicker[i]);
    const limit = quantile(field, 1 - this.level);
    return field.map((value) => value > limit);
  }

  spoil(image) {
    const mask = this.mask();
    return image.map((value, i) => (mask[i] ? 0 : value));
  }

  holes() {
    return this.level;
  }
}

class GlareFilled extends Glare {
  spoil(image) {
    return fillHoles(image, this.mask());
  }
}

class NearField extends Fault {
  spoil(image) {
    return image.map((value) => (value < this.level / RANGE ? 0 : value));
  }

  holes(image) {
    return image.filter((value) => value < this.level / RANGE).length / image.length;
  }
}

class WrongScale extends Fault {
  spoil(image) {
    return image.map((value) => value * this.level);
  }
}

class MotionBlur extends Fault {
  spoil(image, elapsed, { angularVelocity }) {
    const samples = 9;
    const pixels = this.level * 1e-3 * this.contract.focalPixels;
    const [down, right] = [-pixels * angularVelocity[1], pixels * angularVelocity[2]];
    const sum = new Float32Array(image.length);
    for (let n = 0; n < samples; n += 1) {
      const share = n / (samples - 1) - 0.5;
      const moved = shifted(image, share * down, share * right);
      moved.forEach((value, i) => (sum[i] += value / samples));
    }
    return sum;
  }
}

class Frozen extends Fault {
  corrupt(frame, elapsed) {
    if (elapsed < 0 || !this.last) this.last = frame.image;
    return { ...frame, image: this.last };
  }
}

/** Some ticks bring no new frame: the last one is kept and ages. */
class Stale extends Fault {
  corrupt(frame, elapsed) {
    this.held ??= frame;
    const lost = this.missing(elapsed);
    this.held = lost ? { ...this.held, fresh: false, age: this.held.age + TICK } : frame;
    return this.held;
  }
}

class Dropped extends Stale {
  missing(elapsed) {
    return elapsed >= 0 && this.random.uniform() < this.level;
  }
}

class Unplugged extends Stale {
  missing(elapsed) {
    return elapsed >= 0;
  }
}

class Latency extends Fault {
  now = 0;
  past = [];
  served = -Infinity;

  corrupt(frame, elapsed) {
    this.now += TICK;
    const delay = this.random.uniform(0.5, 1.5) * this.level * 1e-3;
    const arrival = elapsed >= 0 ? this.now + delay : this.now;
    const depth = Math.ceil((1.5e-3 * this.level) / TICK) + 2;
    const taken = { image: frame.image, taken: this.now, arrival };
    this.past = [...this.past.slice(1 - depth), taken];
    const newest = this.past.findLast((one) => one.arrival <= this.now + 1e-9) ?? this.past[0];
    const fresh = newest.taken > this.served + 1e-9;
    this.served = newest.taken;
    const age = fresh ? 0 : this.now - newest.arrival;
    return { ...frame, image: newest.image, fresh, age };
  }
}

/** Fault models by their names in the catalogue. */
export const FAULTS = {
  gaussian: Gaussian,
  salt_and_pepper: SaltAndPepper,
  blackout: Blackout,
  saturated: Saturated,
  frozen: Frozen,
  dropped: Dropped,
  latency: Latency,
  occlusion: Occlusion,
  blobs: Blobs,
  grass: Grass,
  glare: Glare,
  glare_filled: GlareFilled,
  near_field: NearField,
  motion_blur: MotionBlur,
  wrong_scale: WrongScale,
  unplugged: Unplugged,
};

function clip(value) {
  return Math.min(Math.max(value, 0), 1);
}

function place(pixel) {
  return [Math.floor(pixel / COLUMNS), pixel % COLUMNS];
}

/** Spatially correlated noise [48 * 64]: a coarse normal grid, interpolated between its nodes. */
function smoothField(random, down, across) {
  const coarse = Array.from({ length: down + 1 }, () =>
    Array.from({ length: across + 1 }, () => random.normal()),
  );
  return Array.from({ length: ROWS * COLUMNS }, (_, i) => {
    const [row, column] = place(i);
    const [r, c] = [(row * down) / (ROWS - 1), (column * across) / (COLUMNS - 1)];
    const [r0, c0] = [Math.min(Math.floor(r), down - 1), Math.min(Math.floor(c), across - 1)];
    const top = mix(coarse[r0][c0], coarse[r0][c0 + 1], c - c0);
    const bottom = mix(coarse[r0 + 1][c0], coarse[r0 + 1][c0 + 1], c - c0);
    return mix(top, bottom, r - r0);
  });
}

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

/** Holes take the nearest measurement to their left, then right, then the row above. */
function fillHoles(image, holes) {
  const rows = Array.from({ length: ROWS }, (_, row) => {
    const [start, end] = [row * COLUMNS, (row + 1) * COLUMNS];
    const known = holes.slice(start, end);
    const first = known.indexOf(false);
    if (first < 0) return null;
    let source = first;
    return Array.from(image.slice(start, end), (_, column) => {
      if (!known[column]) source = column;
      return image[start + source];
    });
  });
  let above = rows.find(Boolean);
  const filled = rows.flatMap((row) => (above = row ?? above));
  return Float32Array.from(filled);
}

/** `image` moved by a fraction of pixels; what moves in repeats the border. */
function shifted(image, down, right) {
  const sample = (from, index, size, shift) => {
    const source = Math.min(Math.max(index - shift, 0), size - 1);
    const low = Math.min(Math.floor(source), size - 2);
    return mix(from(low), from(low + 1), source - low);
  };
  const vertical = image.map((_, i) => {
    const [row, column] = place(i);
    return sample((r) => image[r * COLUMNS + column], row, ROWS, down);
  });
  return image.map((_, i) => {
    const [row, column] = place(i);
    return sample((c) => vertical[row * COLUMNS + c], column, COLUMNS, right);
  });
}
