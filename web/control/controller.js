// The onboard controller: robot state and depth frames in, joint commands out, at 50 Hz.
// Mirrors `src/renet/deploy/controller.py` and `src/renet/pilot/pilot.py`.

import { FrameBuffer } from "./frames.js";
import { heading, observe, projectedGravity } from "./observation.js";
import { Policy } from "./policy.js";
import { Selector } from "./selector.js";

export const DAMPING = "damping";
export const STANDING_UP = "standing_up";
export const WALKING = "walking";

/** Who drives: the selector's choice, with memory or without, or always one estimator. */
export const ESTIMATORS = { camera: "Camera only", forgets: "Without memory", memory: "renet", blind: "Blind only" };

/** Drives one robot with a bundle. */
export class Controller {
  /**
   * @param {object} runtime manifest, contract, bundle and sessions; see load.js.
   * @param {"memory" | "switch"} kind of selector.
   */
  constructor({ manifest, contract, bundle, sessions }, kind = "memory") {
    this.robot = manifest.robot;
    this.contract = contract;
    this.cfg = contract.safety;
    this.policy = new Policy(manifest, contract, sessions);
    this.selectors = bundle.selectors;
    this.choose("memory", kind);
    this.frames = new FrameBuffer();
    this.black = new Float32Array(this.policy.pixels);
    this.mode = DAMPING;
    this.reason = "start";
    this.armed = false;
    this.target = this.start = Array.from(this.robot.default_position);
    this.forget();
  }

  /** Let somebody drive from now on, by all monitors or the paper's rule; trusts vision at first. */
  choose(estimator, kind) {
    this.estimator = estimator;
    const memory = estimator === "forgets" ? { longestMemory: 0 } : {};
    this.selector = new Selector({ ...this.selectors[kind], ...memory }, this.contract);
    this.vision = true;
  }

  /** Start walking as training starts an episode. */
  forget() {
    this.policy.reset();
    this.selector.reset();
    this.action = new Float32Array(this.robot.joints.length);
    this.vision = true;
    this.driving = "";
    this.image = this.black;
  }

  /**
   * One control step.
   * @param {object} state time, jointPosition, jointVelocity, quaternion, angularVelocity.
   * @param {object | null} frame newest of the camera: image, time, invalid.
   * @param {object} teleop speed, turn (sum of all turns asked for, rad), arm.
   * @param {number} now seconds on the robot's clock.
   * @returns {Promise<object>} command: position, stiffness, damping, [12] each.
   */
  async tick(state, frame, teleop, now) {
    this.frames.offer(frame);
    const before = this.mode;
    this.changeMode(this.problem(state, now), teleop, now);
    if (this.mode === DAMPING) {
      this.target = Array.from(state.jointPosition);
      return this.damped();
    }
    if (this.mode === STANDING_UP) {
      if (before !== STANDING_UP) this.start = this.target = Array.from(state.jointPosition);
      return this.limited(this.standUpTarget((now - this.since) / this.cfg.stand_up_seconds), state);
    }
    if (before !== WALKING) {
      this.forget();
      this.yaw = heading(state.quaternion);
      this.turn = teleop.turn;
    }
    return this.walk(state, teleop, now);
  }

  async walk(state, teleop, now) {
    this.steer(teleop.turn, heading(state.quaternion));
    const { maxSpeed, proprioception } = this.contract;
    const speed = clamp(teleop.speed, 0, maxSpeed);
    this.observation = observe(state, this.robot, proprioception, speed, this.yaw, this.action);
    this.policy.remember(this.observation);
    let fresh = false;
    if (this.policy.due) {
      fresh = this.frames.take();
      const { image } = this.frames;
      if (image) this.image = image;
      const gate = this.selector.look(this.seen(fresh, now));
      await this.policy.tick(image, this.estimator === "memory" ? gate : () => true);
    }
    const chosen = { camera: true, forgets: this.vision, memory: this.vision, blind: false }[this.estimator];
    const vision = chosen && this.frames.image !== null;
    const remembers = this.estimator === "memory" && !this.policy.hasImage;
    this.driving = vision ? (remembers ? "remembers" : "sees") : "blind";
    this.action = await this.policy.act(this.observation, vision);
    const command = this.limited(this.policy.jointTarget(this.action), state, this.rateAfter(now - this.since));
    this.vision = this.selector.update(this.seen(fresh, now), now);
    return command;
  }

  seen(fresh, now) {
    const { image, policy, frames } = this;
    return { ...policy, image, fresh, age: frames.age(now), invalid: frames.invalid };
  }

  /** Turn the wished heading on; a robot that cannot follow is not asked for more and more. */
  steer(turn, here) {
    const { maxLead } = this.contract;
    const lead = wrap(this.yaw + turn - this.turn - here);
    this.yaw = here + clamp(lead, -maxLead, maxLead);
    this.turn = turn;
  }

  changeMode(problem, teleop, now) {
    const arm = teleop.arm && !this.armed;
    this.armed = Boolean(teleop.arm);
    const enter = (mode, reason) => Object.assign(this, { mode, reason, since: now });
    if (problem) {
      if (this.mode !== DAMPING) enter(DAMPING, problem);
    } else if (this.mode === DAMPING && arm) enter(STANDING_UP, "armed");
    else if (this.stoodUp(now)) enter(WALKING, "stood up");
  }

  stoodUp(now) {
    return this.mode === STANDING_UP && now - this.since >= this.cfg.stand_up_seconds;
  }

  /** Why a state forbids motion; empty if it does not. */
  problem(state, now) {
    const { cfg, robot } = this;
    if (projectedGravity(state.quaternion)[2] > -Math.cos(cfg.max_tilt)) {
      return `tilted by more than ${((cfg.max_tilt * 180) / Math.PI).toFixed(0)} degrees`;
    }
    for (const [i, q] of state.jointPosition.entries()) {
      if (q < robot.lower[i] - cfg.joint_margin || q > robot.upper[i] + cfg.joint_margin) {
        return `${robot.joints[i]} is out of its range`;
      }
      if (Math.abs(state.jointVelocity[i]) > cfg.max_joint_speed) {
        return `${robot.joints[i]} is too fast`;
      }
      if (this.stoodUp(now) && Math.abs(q - robot.default_position[i]) > cfg.max_stand_up_error) {
        return `${robot.joints[i]} did not follow`;
      }
    }
    const turning = Math.max(...state.angularVelocity.map(Math.abs));
    return turning > cfg.max_turn_rate ? "the base turns too fast" : "";
  }

  damped() {
    const { default_position: position } = this.robot;
    return { position, stiffness: position.map(() => 0), damping: position.map(() => this.cfg.damping) };
  }

  standUpTarget(share) {
    const x = clamp(share, 0, 1);
    const smooth = x * x * (3 - 2 * x);
    return this.start.map((q, i) => q + smooth * (this.robot.default_position[i] - q));
  }

  /** Fastest change of a joint target, rad/s, some seconds after a walk began. */
  rateAfter(walked) {
    const { walk_in_seconds: seconds, first_rate: slow, target_rate: fast } = this.cfg;
    const first = Math.min(slow, fast);
    return first + clamp(walked / seconds, 0, 1) * (fast - first);
  }

  /** Servo command for joint positions [12] rad, within all limits of the safety layer. */
  limited(wished, state, rate = this.cfg.target_rate) {
    const { robot, contract } = this;
    const reach = rate * contract.controlDt;
    const stiffness = [];
    const damping = [];
    this.target = Array.from(wished, (value, i) => {
      const near = clamp(value, this.target[i] - reach, this.target[i] + reach);
      const position = clamp(near, robot.lower[i], robot.upper[i]);
      const spring = robot.stiffness[i] * (position - state.jointPosition[i]);
      const torque = Math.abs(spring - robot.damping[i] * state.jointVelocity[i]);
      const scale = Math.min(1, robot.torque_limit[i] / Math.max(torque, 1e-9));
      stiffness.push(scale * robot.stiffness[i]);
      damping.push(scale * robot.damping[i]);
      return position;
    });
    return { position: this.target, stiffness, damping };
  }
}

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** An angle between -pi and pi, rad. */
const wrap = (angle) => angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
