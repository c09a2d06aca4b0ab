// Draws the robots side by side, each followed by a camera of its own.

import * as THREE from "three";
import { Robot, unpackMeshes } from "./robot.js";
import { buildTerrain } from "./scenery.js";

const SKY = 0xd5e0ea;
const SLOW = 0.045;
const QUICK = 0.022;
/** Seconds a picture takes on average, beside the pause: above the one, resolution falls; below the
 *  other, it rises. */
const SOFTWARE_PAUSE = 33;
/** Milliseconds from one picture to the next where the processor draws: it simulates, too. */

/** One canvas over all slots. */
export class View {
  constructor(canvas, slots, look, { manifest, contract, mujoco }) {
    Object.assign(this, { canvas, slots, mujoco, contract });
    const software = drawsInSoftware();
    // Without a GPU the conversion of each pixel's colour, texture and fog take most of a picture.
    THREE.ColorManagement.enabled = !software;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !software });
    if (software) this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.shadowMap.enabled = !software;
    this.renderer.setScissorTest(true);
    this.finest = software ? 0.8 : Math.min(devicePixelRatio, 2);
    this.ratio = software ? 0.6 : this.finest;
    this.pause = software ? SOFTWARE_PAUSE : 0;
    this.plain = software;
    this.took = 0.03;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(SKY);
    if (!software) this.scene.fog = new THREE.Fog(SKY, 6, 24);
    this.scene.add(new THREE.HemisphereLight(0xf4f8ff, 0x8d887e, 2.1));
    this.sun = this.addSun(1024);
    const geometries = unpackMeshes(look);
    this.robots = slots.map(() => new Robot(look, geometries, manifest, contract, this.plain));
    this.followed = slots.map(() => null);
    for (const { group } of this.robots) this.scene.add(group);
    this.orbit = { turn: -2.4, lift: 0.42, distance: 1.9 };
    this.bindOrbit();
  }

  addSun(size) {
    const sun = new THREE.DirectionalLight(0xfff3df, 2.6);
    sun.castShadow = this.renderer.shadowMap.enabled;
    sun.shadow.mapSize.set(size, size);
    Object.assign(sun.shadow.camera, { left: -2.5, right: 2.5, top: 2.5, bottom: -2.5, near: 0.5, far: 12 });
    sun.shadow.bias = -0.0008;
    sun.shadow.normalBias = 0.01;
    this.scene.add(sun, sun.target);
    return sun;
  }

  bindOrbit() {
    const { canvas, orbit } = this;
    canvas.addEventListener("pointermove", (event) => {
      if (!(event.buttons & 1)) return;
      orbit.turn -= event.movementX * 0.008;
      orbit.lift = Math.min(Math.max(orbit.lift + event.movementY * 0.006, 0.05), 1.4);
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey) return;
        event.preventDefault();
        orbit.distance = Math.min(Math.max(orbit.distance * Math.exp(event.deltaY * 0.002), 0.8), 8);
      },
      { passive: false },
    );
  }

  /** Show other simulations, all on the same ground. */
  reset(simulations) {
    if (this.terrain) this.scene.remove(this.terrain.group);
    const { seenGroups } = this.contract.camera;
    this.terrain = buildTerrain(simulations[0].world, this.mujoco, seenGroups, this.plain);
    this.scene.add(this.terrain.group);
    for (const robot of this.robots) robot.clear();
    this.followed.fill(null);
  }

  /** Draw all simulations; `seconds` since the last picture. */
  draw(simulations, seconds) {
    this.adapt(seconds - this.pause / 1000);
    const { canvas, renderer } = this;
    const frame = canvas.getBoundingClientRect();
    if (canvas.width !== Math.floor(frame.width * this.ratio) || this.height !== frame.height) {
      this.height = frame.height;
      renderer.setPixelRatio(this.ratio);
      renderer.setSize(frame.width, frame.height, false);
    }
    simulations.forEach((simulation, n) => {
      this.robots[n].update(simulation, this.terrain.heightAt);
      this.terrain.follow(simulation.world.pose().position);
      this.robots.forEach(({ group }, other) => (group.visible = other === n));
      const slot = this.slots[n].getBoundingClientRect();
      const box = [slot.left - frame.left, frame.bottom - slot.bottom, slot.width, slot.height];
      renderer.setViewport(...box);
      renderer.setScissor(...box);
      renderer.render(this.scene, this.camera(n, simulation, seconds, slot.width / slot.height));
    });
  }

  /** A camera that follows a robot smoothly; the sun comes along for its shadow. */
  camera(n, simulation, seconds, aspect) {
    const { position, rotation } = simulation.world.pose();
    const yaw = Math.atan2(rotation[1][0], rotation[0][0]);
    const last = (this.followed[n] ??= { position, yaw });
    const share = 1 - Math.exp(-4 * seconds);
    const turn = Math.atan2(Math.sin(yaw - last.yaw), Math.cos(yaw - last.yaw));
    last.position = last.position.map((value, i) => value + share * 1.5 * (position[i] - value));
    last.yaw += share * 0.25 * turn;
    const [x, y, z] = last.position;
    const { turn: aside, lift, distance } = this.orbit;
    const away = distance * Math.max(1, aspect ** -0.6);
    const angle = last.yaw + aside;
    const camera = new THREE.PerspectiveCamera(42, aspect, 0.05, 60);
    camera.up.set(0, 0, 1);
    camera.position.set(
      x + away * Math.cos(lift) * Math.cos(angle),
      y + away * Math.cos(lift) * Math.sin(angle),
      z + away * Math.sin(lift),
    );
    const ahead = 0.25;
    camera.lookAt(x + ahead * Math.cos(last.yaw), y + ahead * Math.sin(last.yaw), z - 0.05);
    this.sun.position.set(x - 1.6, y - 2.2, z + 5);
    this.sun.target.position.set(x, y, z);
    return camera;
  }

  /** Keep pictures quick: fewer pixels first, then no shadows. */
  adapt(seconds) {
    this.took += 0.05 * (seconds - this.took);
    if (this.took > SLOW) {
      if (this.ratio <= 0.5) this.renderer.shadowMap.enabled = this.sun.castShadow = false;
      this.ratio = Math.max(0.5, this.ratio * 0.85);
      this.took = (SLOW + QUICK) / 2;
    } else if (this.took < QUICK && this.ratio < this.finest) {
      this.ratio = Math.min(this.finest, this.ratio * 1.1);
      this.took = (SLOW + QUICK) / 2;
    }
  }
}

/** Whether the browser draws without a GPU. */
function drawsInSoftware() {
  const context = document.createElement("canvas").getContext("webgl2");
  const info = context?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? context.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}
