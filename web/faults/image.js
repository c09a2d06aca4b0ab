// Faults of the picture itself: noise, dirt, light and optics.

import { COLUMNS, Fault, RANGE, ROWS, fillHoles, mix, place, quantile, shifted, smoothField } from "./base.js";

export class Gaussian extends Fault {
  spoil(image) {
    return image.map((value) => value + this.level * this.random.normal());
  }
}

export class SaltAndPepper extends Fault {
  spoil(image) {
    return image.map((value) => {
      const draw = this.random.uniform();
      return draw < this.level ? Number(draw >= 0.5 * this.level) : value;
    });
  }
}

export class Blackout extends Fault {
  spoil(image, elapsed) {
    const remaining = this.level > 0 ? Math.max(1 - elapsed / this.level, 0) : 0;
    return image.map((value) => value * remaining);
  }
}

export class Saturated extends Fault {
  spoil(image) {
    return image.slice().fill(1, 0, Math.round(this.level * ROWS) * COLUMNS);
  }
}

/** A pattern drawn once, when the fault is made: NaN where the image shows through. */
export class FixedPattern extends Fault {
  constructor(...given) {
    super(...given);
    this.pattern = this.draw(new Float32Array(ROWS * COLUMNS).fill(NaN));
  }

  spoil(image) {
    return image.map((value, i) => (Number.isNaN(this.pattern[i]) ? value : this.pattern[i]));
  }
}

export class Occlusion extends FixedPattern {
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

export class Blobs extends FixedPattern {
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

export class Grass extends Fault {
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

export class Glare extends Fault {
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

export class GlareFilled extends Glare {
  spoil(image) {
    return fillHoles(image, this.mask());
  }
}

export class NearField extends Fault {
  spoil(image) {
    return image.map((value) => (value < this.level / RANGE ? 0 : value));
  }

  holes(image) {
    return image.filter((value) => value < this.level / RANGE).length / image.length;
  }
}

export class WrongScale extends Fault {
  spoil(image) {
    return image.map((value) => value * this.level);
  }
}

export class MotionBlur extends Fault {
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
