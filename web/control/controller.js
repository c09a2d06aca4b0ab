// The onboard controller: robot state and depth frames in, joint commands out, at 50 Hz.
// Mirrors `src/renet/deploy/controller.py` and `src/renet/pilot/pilot.py`.

import { FrameBuffer } from "./frames.js";
import { heading, observe, projectedGravity } from "./observation.js";
import { Policy } from "./policy.js";
import { Reach, directionOf, slowed } from "./reach.js";
import { Selector } from "./selector.js";
import { STEERINGS, STILL, limitedVelocity } from "./steering.js";

export const DAMPING = "damping";
export const STANDING_UP = "standing_up";
export const WALKING = "walking";

/** Drives one robot with a bundle. */
export class Controller {
  /**
   * @param {object} runtime manifest, contract, bundle and sessions; see load.js.
   * @param {string} mode of the pilot: one of the contract's `modes`.
   * @param {string} conduct at the end of the ground seen: one of the contract's `reach.speeds`.
   */
  constructor({ manifest, contract, bundle, sessions }, mode, conduct = "walk") {
    this.robot = manifest.robot;
    this.contract = contract;
    this.cfg = contract.safety;
    this.policy = new Policy(manifest, contract, sessions);
    this.told = bundle.told;
    this.steering = new STEERINGS[bundle.told](contract.steering, contract.controlDt);
    this.reach = new Reach(contract.reach, contract.controlDt);
    this.conduct = conduct;
    this.selectors = bundle.selectors;
    this.choose(mode);
    this.frames = new FrameBuffer();
    this.black = new Float32Array(this.policy.pixels);
    /** Of the safety machine: damping, standing up or walking. */
    this.phase = DAMPING;
    this.reason = "start";
    this.armed = false;
    this.target = this.start = Array.from(this.robot.default_position);
    this.forget();
  }

  /** Drive in a mode of the pilot from now on; trusts vision at first. */
  choose(mode) {
    this.mode = mode;
    // Robots that obey no selector show what that of `memory` would object to.
    this.obeys = mode in this.selectors;
    this.selector = new Selector(this.selectors[this.obeys ? mode : "memory"], this.contract);
    this.trusted = true;
  }

  /** Start walking as training starts an episode. */
  forget() {
    this.policy.reset();
    this.selector.reset();
    this.action = new Float32Array(this.robot.joints.length);
    this.trusted = true;
    this.reach.reset();
    /** Whether the command leads to ground that the robot has not seen. */
    this.unseen = false;
    /** Whether the robot has stopped at the end of that ground, and is on level ground beyond it. */
    this.halted = this.beyond = false;
    /** The velocity that is asked for, within limits. */
    this.asked = STILL;
    this.driving = "";
    this.image = this.black;
  }

  /**
   * One control step.
   * @param {object} state time, jointPosition, jointVelocity, quaternion, angularVelocity.
   * @param {object | null} frame newest of the camera: image, time, invalid.
   * @param {object} teleop a `Velocity` of steering.js, and `arm`.
   * @param {number} now seconds on the robot's clock.
   * @returns {Promise<object>} command: position, stiffness, damping, [12] each.
   */
  async tick(state, frame, teleop, now) {
    this.frames.offer(frame);
    const before = this.phase;
    this.changePhase(this.problem(state, now), teleop, now);
    if (this.phase === DAMPING) {
      this.target = Array.from(state.jointPosition);
      return this.damped();
    }
    if (this.phase === STANDING_UP) {
      if (before !== STANDING_UP) this.start = this.target = Array.from(state.jointPosition);
      return this.limited(this.standUpTarget((now - this.since) / this.cfg.stand_up_seconds), state);
    }
    if (before !== WALKING) {
      this.forget();
      this.steering.start(heading(state.quaternion));
    }
    return this.walk(state, teleop, now);
  }

  async walk(state, teleop, now) {
    this.asked = limitedVelocity(teleop, this.contract.steering);
    const wished = this.steering.command(this.asked, heading(state.quaternion));
    const told = this.heedUnseen(wished, state.angularVelocity[2]);
    this.observation = observe(state, this.robot, this.contract.proprioception, told, this.action);
    this.policy.remember(this.observation);
    const fresh = this.policy.due && this.frames.take();
    if (this.policy.due) await this.look(fresh, now);
    // VP imagines ground that it never saw, and robots that are told to stand leap over it.
    const vision = this.mayUseVision && this.frames.image !== null && !this.beyond;
    const remembers = this.mode === "memory" && !this.policy.hasImage;
    this.driving = vision ? (remembers ? "remembers" : "sees") : "blind";
    this.action = await this.policy.act(this.observation, vision);
    const command = this.limited(this.policy.jointTarget(this.action), state, this.rateAfter(now - this.since));
    this.trusted = this.selector.update(this.seen(fresh, now), now);
    return command;
  }

  /** The command, slowed down in front of ground that the robot has not seen, as its conduct asks. */
  heedUnseen(command, turnRate) {
    // Move on from the last image; one that VP has just used is the new origin.
    this.reach.move(this.policy.velocityVp, turnRate);
    if (this.policy.hasImage || this.mode !== "memory") this.reach.reset();
    else if (Number.isNaN(this.policy.imageAge)) this.reach.forget();
    const direction = directionOf(command, this.told);
    this.unseen = this.reach.ends(direction);
    const limit = this.contract.reach.speeds[this.conduct];
    const atEnd = this.unseen && this.reach.canStop(direction, this.policy.heightMap);
    if (!this.unseen || limit !== 0) this.halted = this.beyond = false;
    else if (atEnd && !this.halted) this.halt(direction);
    if (limit === null || !(atEnd || this.halted)) return command;
    return slowed(command, this.told, limit);
  }

  /** Stop, and stay, whatever VP imagines later, while the command leads to ground that was not seen. */
  halt(direction) {
    this.halted = true;
    // A robot that has seen no ground is not beyond any: OP drives it for its own reason.
    const past = this.reach.seen && this.reach.ahead(direction) < 0;
    this.beyond = past && this.reach.standsOnLevelGround(this.policy.heightMap);
  }

  /** Whether a point of the base frame is on ground that the robot has seen, m. */
  hasSeen(forward, left) {
    // An image of the newest tick becomes the origin of the reach in the next step.
    return this.policy.hasImage || this.reach.covers(forward, left);
  }

  /** One tick of vision and both estimators; bad images are withheld in the mode `memory` alone. */
  async look(fresh, now) {
    const { image } = this.frames;
    if (image) this.image = image;
    const gate = this.selector.look(this.seen(fresh, now));
    await this.policy.tick(image, this.mode === "memory" ? gate : () => true, Boolean(fresh));
  }

  /** Whether VP may drive the next step. */
  get mayUseVision() {
    return this.obeys ? this.trusted : this.mode === "camera";
  }

  seen(fresh, now) {
    const { image, policy, frames } = this;
    return { ...policy, image, fresh, age: frames.age(now), invalid: frames.invalid };
  }

  changePhase(problem, teleop, now) {
    const arm = teleop.arm && !this.armed;
    this.armed = Boolean(teleop.arm);
    const enter = (phase, reason) => Object.assign(this, { phase, reason, since: now });
    if (problem) {
      if (this.phase !== DAMPING) enter(DAMPING, problem);
    } else if (this.phase === DAMPING && arm) enter(STANDING_UP, "armed");
    else if (this.stoodUp(now)) enter(WALKING, "stood up");
  }

  stoodUp(now) {
    return this.phase === STANDING_UP && now - this.since >= this.cfg.stand_up_seconds;
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
