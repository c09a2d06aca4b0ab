// Faults made of others: two at once, and one that comes and goes.

import { Fault, TICK_DT } from "./base.js";
import { Blackout, Blobs, Glare } from "./image.js";
import { DisparitySteps, EdgeShadow } from "./stereo.js";
import { Dropped, Frozen, Latency } from "./timing.js";

const PERIOD = 10;
/** Frames from one onset of an intermittent fault to the next. */

/** Two faults at once, the second spoils what the first leaves; levels are the contract's. */
function both(name, First, Second) {
  return class extends Fault {
    constructor(level, random, contract) {
      super(level, random, contract);
      const levels = contract.parts[name].map((each) => each[level - 1]);
      this.faults = [First, Second].map((Kind, n) => new Kind(levels[n], random, contract));
    }

    corrupt(frame, elapsed) {
      return this.faults.reduce((given, fault) => {
        const spoilt = fault.corrupt(given, elapsed);
        return elapsed < 0 ? given : spoilt;
      }, frame);
    }
  };
}

/** A fault that is at work in the first part of every second. */
function intermittent(name, Kind) {
  return class extends Fault {
    constructor(level, random, contract) {
      super(level, random, contract);
      this.fault = new Kind(contract.parts[name][0] ?? Infinity, random, contract);
    }

    corrupt(frame, elapsed) {
      const phase = Math.round(elapsed / TICK_DT) % PERIOD;
      const on = elapsed >= 0 && phase < Math.round(this.level * PERIOD);
      const spoilt = this.fault.corrupt(frame, on ? phase * TICK_DT : -1);
      return on ? spoilt : frame;
    }
  };
}

export const GlareDropped = both("glare_dropped", Glare, Dropped);
export const BlobsLatency = both("blobs_latency", Blobs, Latency);
export const ShadowSteps = both("shadow_steps", DisparitySteps, EdgeShadow);
export const IntermittentBlackout = intermittent("intermittent_blackout", Blackout);
export const IntermittentFrozen = intermittent("intermittent_frozen", Frozen);
export const IntermittentGlare = intermittent("intermittent_glare", Glare);
