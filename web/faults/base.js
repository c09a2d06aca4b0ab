// What all faults of a depth camera share: the interface, and pictures of noise.

export const ROWS = 48;
export const COLUMNS = 64;
export const RANGE = 2.0;
export const TICK_DT = 0.1;

/** One way a camera fails; sees every frame, also before and after the fault. */
export class Fault {
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

/** An image fault that leaves pixels without a measurement; they read zero. */
export class Holes extends Fault {
  spoil(image, elapsed) {
    const lost = this.lost(image, elapsed);
    this.share = lost.reduce((sum, one) => sum + Number(one), 0) / image.length;
    return image.map((value, i) => (lost[i] ? 0 : value));
  }

  holes() {
    return this.share;
  }
}

export function clip(value) {
  return Math.min(Math.max(value, 0), 1);
}

export function place(pixel) {
  return [Math.floor(pixel / COLUMNS), pixel % COLUMNS];
}

/** Spatially correlated noise [48 * 64]: a coarse normal grid, interpolated between its nodes. */
export function smoothField(random, down, across) {
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

export function mix(a, b, share) {
  return a * (1 - share) + b * share;
}

/** As numpy.quantile: linear between the two nearest ranks. */
export function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  const at = share * (sorted.length - 1);
  const low = Math.floor(at);
  return mix(sorted[low], sorted[Math.min(low + 1, sorted.length - 1)], at - low);
}

/** Holes take the nearest measurement to their left, then right, then the row above. */
export function fillHoles(image, holes) {
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
export function shifted(image, down, right) {
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
