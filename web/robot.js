// The Go1 in its colours, the ground it believes in, what its camera covers, and its track.

import * as THREE from "three";

const COLOURS = { trunk: 0xc9d0d8, hip: 0x2a2f36, thigh: 0x3a4048, thigh_mirror: 0x3a4048, calf: 0xaab2bb };
const IDLE = "#667180";
const FAULT = 0xc62f3b;
const WRONG = 0.12;
/** Error of the believed ground, m, at which its colour ends. */
const TRACK = 1500;
/** Points of the track, 0.1 s apart. */
const SUN = new THREE.Vector3(-0.3, -0.4, 0.87);
const SHADE = [0.72, 0.38];
/** Where light is in the colours: the sun, and light on a face across it, and what facing it adds. */

/** Geometries by name of `go1.json`. */
export function unpackMeshes({ step, meshes }) {
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  return Object.fromEntries(
    Object.entries(meshes).map(([name, { positions, indices }]) => {
      const geometry = new THREE.BufferGeometry();
      const metres = Float32Array.from(new Int16Array(bytes(positions)), (n) => n * step);
      geometry.setAttribute("position", new THREE.BufferAttribute(metres, 3));
      geometry.setIndex(new THREE.BufferAttribute(new Uint16Array(bytes(indices)), 1));
      geometry.computeVertexNormals();
      return [name, geometry];
    }),
  );
}

/** The geometry with the light of the sun in its colours, as a part turned like this gets it. */
function lit({ attributes, index }, turn) {
  const { position, normal } = attributes;
  const sun = SUN.clone().applyQuaternion(turn.clone().invert());
  const face = new THREE.Vector3();
  const light = Float32Array.from(normal.array, (_, i) =>
    SHADE[0] + SHADE[1] * face.fromBufferAttribute(normal, Math.floor(i / 3)).dot(sun),
  );
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", position);
  geometry.setAttribute("color", new THREE.BufferAttribute(light, 3));
  return geometry.setIndex(index);
}

/** What is drawn of one simulated robot. */
export class Robot {
  /** `plain`: light in the colours and a spot for a shadow, for browsers without a GPU. */
  constructor(look, geometries, manifest, contract, plain) {
    Object.assign(this, { contract, plain });
    const Material = plain ? THREE.MeshBasicMaterial : THREE.MeshPhongMaterial;
    this.group = new THREE.Group();
    this.bodies = new Map();
    for (const { body, mesh, position, quaternion } of look.geoms) {
      const [w, x, y, z] = quaternion;
      const turn = new THREE.Quaternion(x, y, z, w);
      const material = new Material({ color: COLOURS[mesh], vertexColors: plain });
      const part = new THREE.Mesh(plain ? lit(geometries[mesh], turn) : geometries[mesh], material);
      part.position.set(...position);
      part.quaternion.copy(turn);
      part.castShadow = part.receiveShadow = true;
      part.renderOrder = 2;
      this.body(body).add(part);
    }
    for (const leg of ["FR", "FL", "RR", "RL"]) {
      const foot = new THREE.Mesh(
        new THREE.SphereGeometry(0.023, 12, 8),
        new Material({ color: 0x1b1e23 }),
      );
      foot.position.set(0, 0, -0.213);
      foot.castShadow = true;
      foot.renderOrder = 2;
      this.body(`${leg}_calf`).add(foot);
    }
    this.lamp = this.addLamp();
    this.frustum = this.addFrustum(manifest.camera);
    this.map = this.addMap(contract.heightMap);
    this.track = this.addTrack();
    this.shadow = plain ? this.addShadow() : null;
  }

  body(name) {
    if (!this.bodies.has(name)) {
      const group = new THREE.Group();
      this.bodies.set(name, group);
      this.group.add(group);
    }
    return this.bodies.get(name);
  }

  /** A strip on the back in the colour of the estimator that drives. */
  addLamp() {
    const lamp = new THREE.Mesh(new THREE.BoxGeometry(0.2, 0.035, 0.012), new THREE.MeshBasicMaterial());
    lamp.position.set(0, 0, 0.062);
    lamp.renderOrder = 2;
    this.body(this.contract.base.body).add(lamp);
    return lamp.material;
  }

  addFrustum({ width, height, fx, fy, cx, cy, position, pitch }) {
    const far = 0.7;
    const corners = [[0, 0], [width, 0], [width, height], [0, height]].map(([column, row]) => [
      far, ((cx - column) / fx) * far, ((cy - row) / fy) * far,
    ]);
    const points = corners.flatMap((corner, i) => [[0, 0, 0], corner, corner, corners[(i + 1) % 4]]);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3));
    const lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ transparent: true, opacity: 0.7 }));
    lines.position.set(...position);
    lines.rotation.y = pitch;
    this.body(this.contract.base.body).add(lines);
    return lines.material;
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

  addTrack() {
    const geometry = new THREE.BufferGeometry();
    for (const name of ["position", "color"]) {
      geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(3 * TRACK), 3));
    }
    const track = new THREE.Line(geometry, new THREE.LineBasicMaterial({ vertexColors: true }));
    track.frustumCulled = false;
    this.group.add(track);
    return track;
  }

  /** A dark spot under the trunk. */
  addShadow() {
    const black = { color: 0, transparent: true, opacity: 0.28, depthWrite: false };
    const spot = new THREE.Mesh(new THREE.CircleGeometry(1, 20), new THREE.MeshBasicMaterial(black));
    spot.scale.set(0.3, 0.16, 1);
    this.group.add(spot);
    return spot;
  }

  clear() {
    this.length = 0;
    this.drawnUntil = -Infinity;
  }

  /** Show a simulation as it is now; `heightAt` knows the true ground. */
  update(simulation, heightAt) {
    const { world, controller, camera, now } = simulation;
    this.ids ??= new Map(
      [...this.bodies.keys()].map((name) => {
        const kind = world.mujoco.mjtObj.mjOBJ_BODY.value;
        return [name, world.mujoco.mj_name2id(world.model, kind, name)];
      }),
    );
    const { xpos, xquat } = world.data;
    for (const [name, group] of this.bodies) {
      const id = this.ids.get(name);
      group.position.fromArray(xpos, 3 * id);
      group.quaternion.set(xquat[4 * id + 1], xquat[4 * id + 2], xquat[4 * id + 3], xquat[4 * id]);
    }
    const driving = simulation.walking ? controller.driving : "";
    this.lamp.color.set(this.colourOf(driving));
    this.frustum.color.setHex(camera.broken(now) ? FAULT : 0x2d6cdf);
    if (now >= this.drawnUntil + 0.1 - 1e-9) {
      this.drawnUntil = now;
      this.extendTrack(world.pose().position, driving, heightAt);
    }
    this.updateMap(simulation, heightAt);
    if (this.shadow) {
      const { position, rotation } = world.pose();
      this.shadow.position.set(position[0], position[1], heightAt(...position) + 0.006);
      this.shadow.rotation.z = Math.atan2(rotation[1][0], rotation[0][0]);
    }
  }

  extendTrack([x, y], driving, heightAt) {
    const { position, color } = this.track.geometry.attributes;
    const n = Math.min(this.length, TRACK - 1);
    if (this.length >= TRACK) for (const { array } of [position, color]) array.copyWithin(0, 3);
    position.setXYZ(n, x, y, heightAt(x, y) + 0.01);
    const { r, g, b } = new THREE.Color(this.colourOf(driving));
    color.setXYZ(n, r, g, b);
    this.length = n + 1;
    this.track.geometry.setDrawRange(0, this.length);
    position.needsUpdate = color.needsUpdate = true;
  }

  /** Of a state, or of a robot that does not walk. */
  colourOf(driving) {
    return this.contract.palette[driving] ?? IDLE;
  }

  updateMap({ walking, controller, world }, heightAt) {
    const { heightMap } = controller.policy;
    this.map.visible = walking && heightMap !== null;
    if (!this.map.visible) return;
    const { x: ahead, y: left, baseHeight } = this.contract.heightMap;
    const { position, rotation } = world.pose();
    const yaw = Math.atan2(rotation[1][0], rotation[0][0]);
    const [cosine, sine] = [Math.cos(yaw), Math.sin(yaw)];
    const place = new THREE.Matrix4();
    const colour = new THREE.Color();
    ahead.forEach((forward, i) => {
      left.forEach((side, j) => {
        const n = i * left.length + j;
        const x = position[0] + cosine * forward - sine * side;
        const y = position[1] + sine * forward + cosine * side;
        const z = position[2] - baseHeight - heightMap[n];
        const wrong = Math.min(Math.abs(z - heightAt(x, y)) / WRONG, 1);
        this.map.setMatrixAt(n, place.setPosition(x, y, z + 0.005));
        this.map.setColorAt(n, colour.setHSL(0.58 * (1 - wrong), 0.9, 0.5));
      });
    });
    this.map.instanceMatrix.needsUpdate = true;
    this.map.instanceColor.needsUpdate = true;
  }
}
