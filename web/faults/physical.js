// Camera and driver work, but what they see is not what the feet will meet.

import { Fault } from "./base.js";

/** Frames pass untouched; the camera casts its rays as `view` says: lift, turn, glass. */
class Physical extends Fault {
  corrupt(frame) {
    return frame;
  }
}

/** Obstacles vanish from the rays; `glass` is the index of the severity. */
export class Glass extends Physical {
  get view() {
    return { glass: this.level };
  }
}

/** Every surface appears higher, m. */
export class Foam extends Physical {
  get view() {
    return { lift: this.level };
  }
}

/** The camera is turned in its mount about a random axis. */
export class MountKnocked extends Physical {
  constructor(...given) {
    super(...given);
    const axis = Array.from({ length: 3 }, () => this.random.normal());
    const length = Math.hypot(...axis);
    this.turn = rotation(axis.map((value) => value / length), (this.level * Math.PI) / 180);
  }

  get view() {
    return { turn: this.turn };
  }
}

/** Three rows of the rotation about a unit axis (Rodrigues). */
function rotation([x, y, z], angle) {
  const [sine, cosine] = [Math.sin(angle), Math.cos(angle)];
  const rest = 1 - cosine;
  return [
    [cosine + x * x * rest, x * y * rest - z * sine, x * z * rest + y * sine],
    [y * x * rest + z * sine, cosine + y * y * rest, y * z * rest - x * sine],
    [z * x * rest - y * sine, z * y * rest + x * sine, cosine + z * z * rest],
  ];
}
