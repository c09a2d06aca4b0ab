// Draws the robots side by side, each followed by a camera of its own.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Robot } from "./robot.js";
import { buildTerrain, dark, haze } from "./scenery.js";

const SLOW = 0.045;
const QUICK = 0.022;
/** Seconds a picture takes on average, beside the pause: above the one, resolution falls; below the
 *  other, it rises. */
const SOFTWARE_PAUSE = 33;
/** Milliseconds from one picture to the next where the processor draws: it simulates, too. */
const UP = new THREE.Vector3(0, 0, 1);
const START = [-1.35, -1.25, 0.62];
/** Metres from a robot to the camera that follows it: ahead, left, up. */
const LOWEST = 0.4;
/** Metres of the camera above the ground under it, at least. */
const BRIM = 0.6;
/** Metres from a robot at which, on two opposite sides, the ground is above it in a gap alone. */
const REACH = 0.45;
/** Metres from a robot's middle at which a drag still takes hold of it. */
const PUSH = [0.01, 1.5];
/** m/s of a push for each pixel of a drag, and at most. */

/** One canvas over all slots. */
export class View {
  /** `onPush` is told a push [x, y], m/s in the world frame. */
  constructor(canvas, slots, runtime, onPush) {
    Object.assign(this, { canvas, slots, runtime, onPush });
    this.plain = drawsInSoftware();
    // Without a GPU the conversion of each pixel's colour and texture take most of a picture.
    THREE.ColorManagement.enabled = !this.plain;
    // The sky is the page's background.
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !this.plain, alpha: true });
    if (this.plain) this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.shadowMap.enabled = !this.plain;
    this.renderer.setScissorTest(true);
    this.finest = this.plain ? 0.8 : Math.min(devicePixelRatio, 2);
    this.ratio = this.plain ? 0.6 : this.finest;
    this.pause = this.plain ? SOFTWARE_PAUSE : 0;
    this.took = 0.03;
    this.scene = new THREE.Scene();
    this.scene.fog = haze();
    dark.addEventListener("change", () => {
      this.scene.fog = haze();
      this.terrain.shade();
    });
    this.scene.add(new THREE.HemisphereLight(0xf4f8ff, 0x8d887e, this.plain ? 0.9 : 2.1));
    this.sun = this.addSun();
    this.robots = [];
    /** The push that is being drawn: robot, pointer and where it began, px; null: none. */
    this.push = null;
    this.bindPush();
    /** Where the cameras are, seen from a robot that looks along x. */
    this.orbit = new THREE.PerspectiveCamera(42, 1, 0.05, 90);
    this.orbit.up.copy(UP);
    this.orbit.position.set(...START);
    this.orbitControls = new OrbitControls(this.orbit, canvas);
    Object.assign(this.orbitControls, { enablePan: false, minDistance: 0.8, maxDistance: 8, maxPolarAngle: 1.5 });
    this.turning = false;
    this.orbitControls.addEventListener("start", () => (this.turning = true));
    this.orbitControls.addEventListener("end", () => (this.turning = false));
    // While one finger turns the view, OrbitControls takes all others on the page for it.
    for (const type of ["pointermove", "pointerup"]) {
      document.addEventListener(type, (event) => {
        if (event.target !== canvas) event.stopImmediatePropagation();
      });
    }
  }

  addSun() {
    const sun = new THREE.DirectionalLight(0xfff3df, this.plain ? 1.9 : 2.6);
    sun.castShadow = this.renderer.shadowMap.enabled;
    sun.shadow.mapSize.set(1024, 1024);
    Object.assign(sun.shadow.camera, { left: -2.5, right: 2.5, top: 2.5, bottom: -2.5, near: 0.5, far: 12 });
    sun.shadow.bias = -0.0008;
    sun.shadow.normalBias = 0.01;
    this.scene.add(sun, sun.target);
    return sun;
  }

  /** A drag that begins on a robot pushes; any other turns the view. */
  bindPush() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => {
      if (this.push || this.turning || event.button !== 0) return;
      const n = this.slots.findIndex((slot) => inside(slot.getBoundingClientRect(), event));
      if (n < 0 || !this.boxes[n] || !this.isOn(n, event)) return;
      this.orbitControls.enabled = false;
      this.push = { n, pointer: event.pointerId, x: event.clientX, y: event.clientY };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.pointerId === this.push?.pointer) this.robots[this.push.n].aim(this.pushOf(event));
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => {
        if (event.pointerId !== this.push?.pointer) return;
        const { x, y } = this.pushOf(event);
        this.robots[this.push.n].aim(null);
        this.endPush();
        if (end === "pointerup") this.onPush([x, y]);
      });
    }
  }

  /** The push that a drag up to a pointer asks for, m/s in the world frame. */
  pushOf({ clientX, clientY }) {
    const { n, x, y } = this.push;
    const right = new THREE.Vector3().setFromMatrixColumn(this.cameras[n].matrixWorld, 0).setZ(0).normalize();
    const away = UP.clone().cross(right);
    const [scale, most] = PUSH;
    return right
      .multiplyScalar(scale * (clientX - x))
      .addScaledVector(away, scale * (y - clientY))
      .clampLength(0, most);
  }

  endPush() {
    this.push = null;
    this.orbitControls.enabled = true;
  }

  /** Whether a pointer is on a robot. */
  isOn(n, { clientX, clientY }) {
    const [left, top, width, height] = this.boxes[n];
    const at = new THREE.Vector2((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(at, this.cameras[n]);
    return ray.ray.distanceToPoint(this.robots[n].trunk.position) < REACH;
  }

  /** Show other simulations, all on the same ground. */
  reset(simulations) {
    const before = [this.terrain, ...this.robots].flatMap((one) => one?.group ?? []);
    before.forEach(free);
    this.scene.remove(...before);
    this.endPush();
    const { seenGroups } = this.runtime.contract.camera;
    this.terrain = buildTerrain(simulations[0].world, seenGroups, this.plain);
    this.robots = simulations.map(({ world }) => new Robot(this.runtime, world, this.plain));
    this.scene.add(this.terrain.group, ...this.robots.map(({ group }) => group));
    this.followed = simulations.map(() => null);
    this.cameras = simulations.map(() => null);
    /** Where each is drawn: left, top, width, height in the window. */
    this.boxes = [];
  }

  /** Draw all simulations; `seconds` since the last picture. */
  draw(simulations, seconds) {
    this.adapt(seconds - this.pause / 1000);
    this.orbitControls.update();
    const { canvas, renderer } = this;
    const frame = canvas.getBoundingClientRect();
    const size = `${frame.width} ${frame.height} ${this.ratio}`;
    if (this.size !== size) {
      this.size = size;
      renderer.setPixelRatio(this.ratio);
      renderer.setSize(frame.width, frame.height, false);
    }
    const rects = this.slots.map((slot) => slot.getBoundingClientRect());
    const lowest = Math.max(...rects.map(({ bottom }) => bottom));
    simulations.forEach((simulation, n) => {
      this.robots[n].update(simulation, this.terrain.heightAt);
      this.terrain.follow(simulation.world.pose().position);
      this.robots.forEach(({ group }, other) => (group.visible = other === n));
      const { left, top, width, height } = rects[n];
      // Pictures go on behind the controls.
      const whole = rects[n].bottom === lowest ? frame.bottom - top : height;
      this.boxes[n] = [left, top, width, whole];
      const box = [left - frame.left, frame.bottom - top - whole, width, whole];
      renderer.setViewport(...box);
      renderer.setScissor(...box);
      const camera = this.camera(n, simulation, seconds, width / height);
      camera.setViewOffset(width, height, 0, 0, width, whole);
      renderer.render(this.scene, camera);
    });
  }

  /** A camera that follows a robot smoothly; the sun comes along for its shadow. */
  camera(n, simulation, seconds, aspect) {
    const { position, yaw } = simulation.world.pose();
    const last = (this.followed[n] ??= { position: new THREE.Vector3(...position), yaw });
    const share = 1 - Math.exp(-4 * seconds);
    const turn = Math.atan2(Math.sin(yaw - last.yaw), Math.cos(yaw - last.yaw));
    last.position.lerp(new THREE.Vector3(...position), Math.min(1.5 * share, 1));
    last.yaw += share * 0.25 * turn;
    const { x, y, z } = last.position;
    const camera = (this.cameras[n] = this.orbit.clone());
    camera.aspect = aspect;
    const away = Math.max(1, aspect ** -0.6);
    camera.position.multiplyScalar(away).applyAxisAngle(UP, last.yaw).add(last.position);
    // It does not fall into a gap with its robot, but looks in from above.
    const { heightAt } = this.terrain;
    const lower = ([dx, dy]) => Math.min(heightAt(x + dx, y + dy), heightAt(x - dx, y - dy));
    const brim = Math.max(...[[BRIM, 0], [0, BRIM]].map(lower));
    const sunk = THREE.MathUtils.clamp((brim - z) / BRIM, 0, 0.8);
    camera.position.lerp(new THREE.Vector3(x, y, brim + 2), sunk);
    const ground = heightAt(camera.position.x, camera.position.y);
    camera.position.z = Math.max(camera.position.z, ground + LOWEST);
    camera.lookAt(x + 0.25 * Math.cos(last.yaw), y + 0.25 * Math.sin(last.yaw), z - 0.05);
    camera.updateMatrixWorld();
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

/** Give back what a group has on the GPU, to which shapes that are drawn again are copied anew. */
function free(group) {
  group.traverse((part) => {
    part.geometry?.dispose();
    part.material?.map?.dispose();
    if (part.isInstancedMesh) part.dispose();
  });
}

function inside({ left, right, top, bottom }, { clientX, clientY }) {
  return clientX >= left && clientX < right && clientY >= top && clientY < bottom;
}

/** Whether the browser draws without a GPU. */
function drawsInSoftware() {
  const context = document.createElement("canvas").getContext("webgl2");
  const info = context?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? context.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}
