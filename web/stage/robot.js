// A robot in its colours, and the ground that it believes in.

import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const IDLE = "#667180";
const PUSH = "#c62f3b";
const WRONG = 0.25;
/** Error of the believed ground, m, from which on it is drawn black. */
const BODY_GREY = 0x98a1ab;

/** Nodes of a glTF file whose names begin with a body's; they lie in that body's frame. */
export async function loadLook(bytes) {
  const { scene } = await new GLTFLoader().parseAsync(bytes.buffer, "");
  return scene.children;
}

/** The collision shapes of a model, as nodes, for a robot that has no look of its own. */
export function shapesOf({ mujoco, model }, seenGroups) {
  const { mjGEOM_SPHERE, mjGEOM_CAPSULE, mjGEOM_CYLINDER, mjGEOM_BOX } = mujoco.mjtGeom;
  const shapes = {
    [mjGEOM_SPHERE.value]: ([radius]) => new THREE.SphereGeometry(radius, 12, 8),
    [mjGEOM_CAPSULE.value]: ([radius, half]) =>
      new THREE.CapsuleGeometry(radius, 2 * half, 4, 10).rotateX(Math.PI / 2),
    [mjGEOM_CYLINDER.value]: ([radius, half]) =>
      new THREE.CylinderGeometry(radius, radius, 2 * half, 14).rotateX(Math.PI / 2),
    [mjGEOM_BOX.value]: (half) => new THREE.BoxGeometry(...Array.from(half, (value) => 2 * value)),
  };
  const nodes = [];
  for (let geom = 0; geom < model.ngeom; geom += 1) {
    const shape = shapes[model.geom_type[geom]];
    if (seenGroups[model.geom_group[geom]] || !shape) continue;
    const geometry = shape(model.geom_size.slice(3 * geom, 3 * geom + 3));
    const node = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color: BODY_GREY }));
    const [w, x, y, z] = model.geom_quat.slice(4 * geom, 4 * geom + 4);
    node.position.fromArray(model.geom_pos, 3 * geom);
    node.quaternion.set(x, y, z, w);
    node.body = model.geom_bodyid[geom];
    nodes.push(node);
  }
  return nodes;
}

/** What is drawn of one simulated robot. */
export class Robot {
  /** `plain`: cheap light and a spot for a shadow, for browsers without a GPU. */
  constructor({ contract, bundle, look }, world, plain) {
    Object.assign(this, { contract, plain });
    this.group = new THREE.Group();
    this.bodies = new Map();
    for (const node of look ?? shapesOf(world, contract.camera.seenGroups)) {
      this.body(node.body ?? world.body(node.name.split("-")[0])).add(this.dress(node.clone()));
    }
    this.trunk = this.body(world.body(bundle.base.body));
    this.lamp = this.addLamp();
    this.map = this.addMap(contract.heightMap);
    this.shadow = plain ? this.addShadow() : null;
    this.arrow = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(), 1, PUSH, 0.15, 0.1);
    this.arrow.visible = false;
    this.group.add(this.arrow);
  }

  body(id) {
    if (!this.bodies.has(id)) {
      const group = new THREE.Group();
      this.bodies.set(id, group);
      this.group.add(group);
    }
    return this.bodies.get(id);
  }

  /** A part with the material of its colour that this browser draws quickly, drawn over the map. */
  dress(node) {
    node.traverse((part) => {
      part.renderOrder = 2;
      part.castShadow = part.receiveShadow = true;
      if (!part.isMesh || !this.plain) return;
      const { color } = part.material;
      part.material = new THREE.MeshLambertMaterial({ color: color.clone().convertLinearToSRGB() });
    });
    return node;
  }

  /** A strip on the back, wherever that is, in the colour of the state. */
  addLamp() {
    const lamp = new THREE.Mesh(new THREE.BoxGeometry(0.2, 0.035, 0.012), new THREE.MeshBasicMaterial());
    this.trunk.updateMatrixWorld();
    const down = new THREE.Raycaster(new THREE.Vector3(0, 0, 1), new THREE.Vector3(0, 0, -1));
    lamp.position.copy(down.intersectObject(this.trunk)[0].point);
    lamp.renderOrder = 2;
    this.trunk.add(lamp);
    return lamp.material;
  }

  addMap({ x, y }) {
    const disc = new THREE.CircleGeometry(0.032, this.plain ? 6 : 16);
    const map = new THREE.InstancedMesh(disc, new THREE.MeshBasicMaterial(), x.length * y.length);
    map.frustumCulled = false;
    // Over the ground, wherever it is believed to be, and under the robot.
    map.material.depthTest = map.material.depthWrite = false;
    map.renderOrder = 1;
    this.group.add(map);
    return map;
  }

  /** A dark spot under the trunk. */
  addShadow() {
    const black = { color: 0, transparent: true, opacity: 0.3, depthWrite: false };
    const spot = new THREE.Mesh(new THREE.CircleGeometry(1, 20), new THREE.MeshBasicMaterial(black));
    spot.scale.set(0.32, 0.17, 1);
    this.group.add(spot);
    return spot;
  }

  /** Show a simulation as it is now; `heightAt` knows the true ground. */
  update(simulation, heightAt) {
    const { world, state } = simulation;
    const { xpos, xquat } = world.data;
    for (const [id, group] of this.bodies) {
      group.position.fromArray(xpos, 3 * id);
      group.quaternion.set(xquat[4 * id + 1], xquat[4 * id + 2], xquat[4 * id + 3], xquat[4 * id]);
    }
    const colour = this.contract.palette[state]?.colour ?? IDLE;
    this.lamp.color.set(colour);
    const { position, yaw } = world.pose();
    this.updateMap(simulation, colour, heightAt);
    if (!this.shadow) return;
    this.shadow.position.set(position[0], position[1], heightAt(...position) + 0.006);
    this.shadow.rotation.z = yaw;
  }

  /** VP's map of the ground: in the colour of the state, black where it is wrong; unseen ground in its own. */
  updateMap({ state, controller, world }, colour, heightAt) {
    const { heightMap } = controller.policy;
    this.map.visible = heightMap !== null && (state === "sees" || state === "remembers");
    if (!this.map.visible) return;
    const { x: ahead, y: left, baseHeight } = this.contract.heightMap;
    const { position, yaw } = world.pose();
    const [cosine, sine] = [Math.cos(yaw), Math.sin(yaw)];
    const place = new THREE.Matrix4();
    const [right, black, shade] = [new THREE.Color(colour), new THREE.Color(0), new THREE.Color()];
    const unseen = new THREE.Color(this.contract.palette.unseen.colour);
    ahead.forEach((forward, i) => {
      left.forEach((side, j) => {
        const n = i * left.length + j;
        const x = position[0] + cosine * forward - sine * side;
        const y = position[1] + sine * forward + cosine * side;
        const z = position[2] - baseHeight - heightMap[n];
        const wrong = Math.min(Math.abs(z - heightAt(x, y)) / WRONG, 1);
        this.map.setMatrixAt(n, place.setPosition(x, y, z + 0.005));
        const seen = controller.hasSeen(forward, side);
        this.map.setColorAt(n, seen ? shade.lerpColors(right, black, wrong) : unseen);
      });
    });
    this.map.instanceMatrix.needsUpdate = true;
    this.map.instanceColor.needsUpdate = true;
  }

  /** Show the push, m/s in the world frame, that a drag asks for; null: none. */
  aim(push) {
    this.arrow.visible = push !== null && push.length() > 0.05;
    if (!this.arrow.visible) return;
    this.arrow.position.copy(this.trunk.position);
    this.arrow.setDirection(push.clone().normalize());
    this.arrow.setLength(0.25 + 0.5 * push.length(), 0.15, 0.1);
  }
}
