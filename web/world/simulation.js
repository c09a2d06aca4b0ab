// One simulated robot in MuJoCo's WebAssembly build, with its camera and its controller.

import { Controller, DAMPING, WALKING } from "../control/controller.js";
import { STILL } from "../control/steering.js";
import { DepthCamera } from "./camera.js";

const FALLING = 0.7;
/** Cosine of the tilt from which on a robot that walks is about to fall. */
const SMOOTHING = 0.5;
/** Time constant of the velocity that is walked, s; a gait's own swing is faster. */

/** The scene and the robot in it: state in, joint commands out. */
export class World {
  /**
   * @param {object} runtime mujoco, manifest, contract and bundle; see load.js.
   * @param {object} ground one of the bundle's: xml, start (height of the ground at x = y = 0).
   */
  constructor({ mujoco, manifest: { robot }, contract, bundle }, ground) {
    this.mujoco = mujoco;
    this.model = mujoco.MjModel.from_xml_string(ground.xml);
    this.data = new mujoco.MjData(this.model);
    this.steps = Math.round(contract.controlDt / contract.physicsDt);
    const { model, data } = this;
    const { mjOBJ_JOINT, mjOBJ_ACTUATOR } = mujoco.mjtObj;
    const find = (kind, name) => mujoco.mj_name2id(model, kind.value, name);
    this.base = this.body(bundle.base.body);
    const joints = robot.joints.map((name) => find(mjOBJ_JOINT, name));
    this.servos = robot.joints.map((name) => find(mjOBJ_ACTUATOR, name));
    this.position = joints.map((joint) => model.jnt_qposadr[joint]);
    this.velocity = joints.map((joint) => model.jnt_dofadr[joint]);
    const free = model.body_jntadr[this.base];
    [this.free, this.spin] = [model.jnt_qposadr[free], model.jnt_dofadr[free] + 3];
    data.qpos.set([0, 0, ground.start + bundle.base.height, 1, 0, 0, 0], this.free);
    this.position.forEach((at, i) => (data.qpos[at] = robot.default_position[i]));
    const limp = robot.joints.map(() => 0);
    this.write({ position: robot.default_position, stiffness: limp, damping: limp });
    mujoco.mj_forward(model, data);
  }

  get now() {
    return this.data.time;
  }

  /** Index of a body by its name, or -1. */
  body(name) {
    return this.mujoco.mj_name2id(this.model, this.mujoco.mjtObj.mjOBJ_BODY.value, name);
  }

  /** Sensors, as a robot's driver reports them. */
  read() {
    const { qpos, qvel, time } = this.data;
    return {
      time,
      jointPosition: this.position.map((at) => qpos[at]),
      jointVelocity: this.velocity.map((at) => qvel[at]),
      quaternion: Array.from(qpos.slice(this.free + 3, this.free + 7)),
      angularVelocity: Array.from(qvel.slice(this.spin, this.spin + 3)),
    };
  }

  /** Hand a command to the joint servos, which hold it until the next. */
  write({ position, stiffness, damping }) {
    const { ctrl } = this.data;
    const { actuator_gainprm: gain, actuator_biasprm: bias, nu } = this.model;
    const [gains, biases] = [gain.length / nu, bias.length / nu];
    this.servos.forEach((servo, i) => {
      ctrl[servo] = position[i];
      gain[servo * gains] = stiffness[i];
      bias[servo * biases + 1] = -stiffness[i];
      bias[servo * biases + 2] = -damping[i];
    });
  }

  /** One control period. */
  advance() {
    for (let n = 0; n < this.steps; n += 1) this.mujoco.mj_step(this.model, this.data);
    this.mujoco.mj_forward(this.model, this.data);
  }

  /** Add to the base's velocity, m/s in the world frame. */
  push(velocity) {
    velocity.forEach((value, i) => (this.data.qvel[this.spin - 3 + i] += value));
  }

  /** The base's position [3] m, rotation (three rows), and yaw, rad. */
  pose() {
    const at = 9 * this.base;
    const matrix = Array.from(this.data.xmat.slice(at, at + 9));
    const rotation = [matrix.slice(0, 3), matrix.slice(3, 6), matrix.slice(6, 9)];
    const position = Array.from(this.data.xpos.slice(3 * this.base, 3 * this.base + 3));
    return { position, rotation, yaw: Math.atan2(rotation[1][0], rotation[0][0]) };
  }

  /** @returns {import("../control/steering.js").Velocity} of the base as it is. */
  baseVelocity() {
    const { qvel } = this.data;
    const [x, y] = qvel.slice(this.spin - 3, this.spin - 1);
    const { yaw } = this.pose();
    return {
      forward: Math.cos(yaw) * x + Math.sin(yaw) * y,
      left: -Math.sin(yaw) * x + Math.cos(yaw) * y,
      turnRate: qvel[this.spin + 2],
    };
  }

  /** Distances and geoms hit by rays from one point, in groups that are seen. */
  castRays(eye, directions, groups) {
    const { mujoco, model, data } = this;
    const rays = directions.length / 3;
    if (this.rays !== rays) {
      this.rays = rays;
      this.hits = new mujoco.IntBuffer(rays);
      this.distances = new mujoco.DoubleBuffer(rays);
    }
    const [fixed, nobody, noNormals, anyDistance] = [true, -1, null, 1e10];
    mujoco.mj_multiRay(
      model, data, eye, directions, groups, fixed, nobody,
      this.hits, this.distances, noNormals, rays, anyDistance,
    );
    return { hit: this.hits.GetView(), distance: this.distances.GetView() };
  }

  /** Give the memory back. */
  delete() {
    for (const buffer of [this.hits, this.distances, this.data, this.model]) buffer?.delete();
  }
}

/** A robot that is stood up and then walks as it is asked to. */
export class Simulation {
  /**
   * Like World's and Controller's.
   * @param {object} runtime
   * @param {object} ground
   * @param {number} seed of the camera's noise and faults.
   * @param {string} mode of the pilot.
   * @param {string} [conduct] at the end of the ground seen.
   */
  constructor(runtime, ground, seed, mode, conduct) {
    this.world = new World(runtime, ground);
    this.camera = new DepthCamera(this.world, runtime.manifest.camera, runtime.contract.camera, seed);
    this.controller = new Controller(runtime, mode, conduct);
    /** Velocity of the base over the last half second. */
    this.walked = STILL;
    this.share = 1 - Math.exp(-runtime.contract.controlDt / SMOOTHING);
  }

  get now() {
    return this.world.now;
  }

  get walking() {
    return this.controller.phase === WALKING;
  }

  /** Cosine of the tilt. */
  get upright() {
    return this.world.pose().rotation[2][2];
  }

  get falling() {
    return this.walking && this.upright < FALLING;
  }

  /** Whether the controller has given up on a robot that had begun. */
  get fell() {
    return this.controller.reason !== "start" && this.controller.phase === DAMPING;
  }

  /** "sees", "remembers" or "blind"; empty while it does not walk. */
  get state() {
    return this.walking ? this.controller.driving : "";
  }

  /**
   * One control step, 0.02 s.
   * @param {import("../control/steering.js").Velocity} velocity asked for.
   */
  async step(velocity) {
    const { world, now } = this;
    const state = world.read();
    const frame = this.camera.latest(now);
    const teleop = { ...velocity, arm: now === 0 };
    world.write(await this.controller.tick(state, frame, teleop, now));
    world.advance();
    this.measure();
  }

  /** Keep the velocity that is walked. */
  measure() {
    const newest = this.world.baseVelocity();
    const smoothed = {};
    for (const [component, value] of Object.entries(this.walked)) {
      smoothed[component] = value + this.share * (newest[component] - value);
    }
    this.walked = smoothed;
  }

  delete() {
    this.world.delete();
  }
}
