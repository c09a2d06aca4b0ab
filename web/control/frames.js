// From camera frames to what policy and selector get: the newest image, and how old it is.
// Mirrors `src/renet/deploy/cameras/buffer.py`.

/** Keeps the newest image of a depth camera, rounded to half precision as in training. */
export class FrameBuffer {
  image = null;
  invalid = 0;
  time = -Infinity;
  fresh = false;

  /** Look at what the camera has; called at every control tick. */
  offer(frame) {
    if (!frame || frame.time <= this.time) return;
    this.image = frame.image.map(toHalf);
    this.invalid = frame.invalid;
    this.time = frame.time;
    this.fresh = true;
  }

  /** Seconds since the image was taken. */
  age(now) {
    return Math.min(Math.max(now - this.time, 0), 1e3);
  }

  /** Whether the image is new since the last vision tick, which this call begins. */
  take() {
    const { fresh } = this;
    this.fresh = false;
    return fresh;
  }
}

/** A number in [0, 1] rounded to the nearest half-precision one, ties to even. */
export function toHalf(value) {
  const step = value < 2 ** -14 ? 2 ** -24 : 2 ** (Math.floor(Math.log2(value)) - 10);
  const scaled = value / step;
  const floor = Math.floor(scaled);
  const rest = scaled - floor;
  return (rest > 0.5 || (rest === 0.5 && floor % 2 === 1) ? floor + 1 : floor) * step;
}
