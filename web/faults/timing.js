// Faults of time: every image is a good one, but not the one the robot should have now.

import { Fault, TICK_DT } from "./base.js";

export class Frozen extends Fault {
  corrupt(frame, elapsed) {
    if (elapsed < 0 || !this.last) this.last = frame.image;
    return { ...frame, image: this.last };
  }
}

/** Some ticks bring no new frame: the last one is kept and ages. */
export class Stale extends Fault {
  corrupt(frame, elapsed) {
    this.held ??= frame;
    const lost = this.missing(elapsed);
    this.held = lost ? { ...this.held, fresh: false, age: this.held.age + TICK_DT } : frame;
    return this.held;
  }
}

export class Dropped extends Stale {
  missing(elapsed) {
    return elapsed >= 0 && this.random.uniform() < this.level;
  }
}

export class Unplugged extends Stale {
  missing(elapsed) {
    return elapsed >= 0;
  }
}

export class Latency extends Fault {
  now = 0;
  past = [];
  served = -Infinity;

  corrupt(frame, elapsed) {
    this.now += TICK_DT;
    const delay = this.random.uniform(0.5, 1.5) * this.level * 1e-3;
    const arrival = elapsed >= 0 ? this.now + delay : this.now;
    const depth = Math.ceil((1.5e-3 * this.level) / TICK_DT) + 2;
    const taken = { image: frame.image, taken: this.now, arrival };
    this.past = [...this.past.slice(1 - depth), taken];
    const newest = this.past.findLast((one) => one.arrival <= this.now + 1e-9) ?? this.past[0];
    const fresh = newest.taken > this.served + 1e-9;
    this.served = newest.taken;
    const age = fresh ? 0 : this.now - newest.arrival;
    return { ...frame, image: newest.image, fresh, age };
  }
}
