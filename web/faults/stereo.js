// What a stereo camera does in good light, and in tall grass.

import { COLUMNS, Fault, Holes, RANGE, ROWS, place, quantile, smoothField } from "./base.js";

/** Disparity [48 * 64] in pixels of an image whose sensor grain a 3 x 3 median took away. */
function disparity(image, baseline, { focal, nearest }) {
  const near = (row, column) =>
    image[Math.min(Math.max(row, 0), ROWS - 1) * COLUMNS + Math.min(Math.max(column, 0), COLUMNS - 1)];
  const window = new Float32Array(9);
  return Float64Array.from(image, (_, i) => {
    const [row, column] = place(i);
    for (let n = 0; n < 9; n += 1) {
      window[n] = near(row + Math.floor(n / 3) - 1, column + (n % 3) - 1);
    }
    return (focal * baseline) / Math.max(window.sort()[4] * RANGE, nearest);
  });
}

export class EdgeShadow extends Holes {
  lost(image) {
    const shift = disparity(image, 1e-3 * this.level, this.contract.stereo);
    const hidden = new Array(image.length).fill(false);
    for (let row = 0; row < ROWS; row += 1) {
      let nearest = Infinity;
      for (let column = COLUMNS - 1; column >= 0; column -= 1) {
        const i = row * COLUMNS + column;
        hidden[i] = nearest <= column - shift[i];
        nearest = Math.min(nearest, column - shift[i]);
      }
    }
    return hidden;
  }
}

export class DisparitySteps extends Fault {
  spoil(image) {
    const { focal, baseline } = this.contract.stereo;
    const scale = (focal * baseline) / RANGE;
    return image.map((value) => {
      if (!(value > 0 && value < 1)) return value;
      const steps = Math.max(Math.round(scale / value / this.level), 1);
      return scale / (steps * this.level);
    });
  }
}

export class Textureless extends Holes {
  constructor(...given) {
    super(...given);
    this.field = smoothField(this.random, 3, 4);
  }

  lost(image) {
    const smooth = smoothSurface(image, this.contract.stereo);
    const flicker = smoothField(this.random, 12, 16);
    const field = this.field.map((value, i) => value + 0.15 * flicker[i]);
    if (!smooth.some(Boolean)) return smooth;
    const limit = quantile(field.filter((_, i) => smooth[i]), 1 - this.level);
    return smooth.map((flat, i) => flat && field[i] > limit);
  }
}

/** Pixels whose disparity lies on the plane through its neighbours'. */
function smoothSurface(image, stereo) {
  const shift = disparity(image, stereo.baseline, stereo);
  const far = 2;
  // Beyond the border, the image goes on as if turned around its last pixel.
  const along = (at, step, index, size) => {
    const value = (n) => shift[at + (n - index) * step];
    if (index + far >= size) {
      const mirror = 2 * (size - 1) - (index + far);
      return [2 * value(size - 1) - value(mirror), value(index - far)];
    }
    if (index < far) return [value(index + far), 2 * value(0) - value(far - index)];
    return [value(index + far), value(index - far)];
  };
  return Array.from(shift, (here, i) => {
    const [row, column] = place(i);
    const [right, left] = along(i, 1, column, COLUMNS);
    const [below, above] = along(i, COLUMNS, row, ROWS);
    const bent = Math.max(Math.abs((right + left) / 2 - here), Math.abs((below + above) / 2 - here));
    return bent < stereo.flatDisparity;
  });
}

export class TallGrass extends Holes {
  spoil(image, elapsed) {
    this.blades = this.depth();
    return super.spoil(image.map((value, i) => Math.min(value, this.blades[i])), elapsed);
  }

  lost(image) {
    const { unmatched, nearRange } = this.contract.grass;
    return Array.from(image, (value, i) => {
      const lost = this.random.uniform() < unmatched || this.blades[i] < nearRange / RANGE;
      return lost && this.blades[i] < 1 && value >= this.blades[i];
    });
  }

  /** Depth [48 * 64] of the nearest blade in one frame, infinity where there is none. */
  depth() {
    const { random, contract } = this;
    const { fx, fy, cx, cy, pitch, cameraHeight, reach, height, width, sway } = contract.grass;
    const nearest = new Float32Array(ROWS * COLUMNS).fill(Infinity);
    const halfView = (0.5 * COLUMNS) / fx;
    for (let blade = 0; blade < this.level; blade += 1) {
      const distance = Math.exp(random.uniform(Math.log(reach[0]), Math.log(reach[1])));
      const tall = random.uniform(...height);
      const root = (random.uniform(-halfView, halfView) * distance) / Math.cos(pitch);
      const lean = random.uniform(-sway, sway);
      for (let row = 0; row < ROWS; row += 1) {
        const drop = distance * Math.tan(pitch + Math.atan((row + 0.5 - cy) / fy));
        const depth = distance * Math.cos(pitch) + drop * Math.sin(pitch);
        const along = (cameraHeight - drop) / tall;
        if (along < 0 || along > 1) continue;
        const middle = cx + (fx * (root + along * lean)) / depth;
        const half = 0.5 * Math.max((fx * width) / depth, 1);
        const first = Math.max(Math.ceil(middle - half - 0.5), 0);
        for (let column = first; column < COLUMNS && column + 0.5 <= middle + half; column += 1) {
          const i = row * COLUMNS + column;
          nearest[i] = Math.min(nearest[i], depth / RANGE);
        }
      }
    }
    return nearest;
  }
}
