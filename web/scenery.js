// The ground as it is simulated: its boxes with texture, edges and shadow.

import * as THREE from "three";

const TEXTURE_METRES = 2;
/** Side of the ground that the texture covers once. */
const FLOOR = 0xb9c2c9;
const JOINT = 0x8f979e;
const WIDE = 5;
/** Half-size in m from which a box is ground rather than an obstacle, and gets no edges. */
const BAKED = [0.62, 0.78, 1];
/** Light on faces across x, y and z where it is in the colours. */
const SLAB = 0.5;
/** Side of the ground's slabs, m. */
const SLABS = 24;
/** Along each side of the square around a robot in which the floor's joints are drawn as lines. */
const RAISED = 0.003;
/** Metres of those lines above the ground. */

/**
 * The terrain as a group, a function for the height of the ground, and one to be called with the
 * position of the robot that is drawn next.
 * @param {object} world a `World`.
 * @param {object} mujoco the loaded WebAssembly module.
 * @param {number[]} seenGroups whether the camera sees each geom group.
 * @param {boolean} plain light is in the colours, and lines stand for texture: for browsers that
 *   draw without a GPU, where texture, light and shadow of each pixel take most of a picture.
 */
export function buildTerrain(world, mujoco, seenGroups, plain) {
  const { model, data } = world;
  const boxes = [];
  for (let geom = 0; geom < model.ngeom; geom += 1) {
    if (!seenGroups[model.geom_group[geom]]) continue;
    const size = Array.from(model.geom_size.slice(3 * geom, 3 * geom + 3));
    const at = Array.from(data.geom_xpos.slice(3 * geom, 3 * geom + 3));
    const rgba = model.geom_rgba.slice(4 * geom, 4 * geom + 3);
    const plane = model.geom_type[geom] === mujoco.mjtGeom.mjGEOM_PLANE.value;
    const half = plane ? [size[0], size[1], 0.5] : size;
    if (plane) at[2] -= 0.5;
    boxes.push({ at, half, colour: new THREE.Color().setRGB(...rgba, THREE.SRGBColorSpace) });
  }
  const group = new THREE.Group();
  group.add(solid(boxes, plain), lines(boxes));
  let follow = () => {};
  if (plain) {
    const floor = Math.max(...boxes.filter(isWide).map(top));
    const around = new THREE.GridHelper(SLABS * SLAB, SLABS, JOINT, JOINT).rotateX(Math.PI / 2);
    const slab = (at) => SLAB * Math.round(at / SLAB);
    follow = ([x, y]) => around.position.set(slab(x), slab(y), floor + RAISED);
    group.add(around, joints(boxes));
  }
  return { group, heightAt: (x, y) => heightAt(boxes, x, y), follow };
}

const top = ({ at, half }) => at[2] + half[2];
const isWide = ({ half }) => Math.max(...half) >= WIDE;

/** Highest surface above a point, or minus infinity. */
function heightAt(boxes, x, y) {
  let highest = -Infinity;
  for (const { at, half } of boxes) {
    if (Math.abs(x - at[0]) <= half[0] && Math.abs(y - at[1]) <= half[1]) {
      highest = Math.max(highest, at[2] + half[2]);
    }
  }
  return highest;
}

/** All boxes as one mesh, so that they are one call to draw. */
function solid(boxes, plain) {
  const parts = boxes.map(({ at, half, colour }) => {
    const box = new THREE.BoxGeometry(...half.map((value) => 2 * value)).translate(...at);
    const { position, normal, uv } = box.attributes;
    const tint = colour.clone().lerp(new THREE.Color(FLOOR), half[0] > WIDE ? 0.6 : 0.2);
    const colours = new Float32Array(3 * position.count);
    for (let i = 0; i < position.count; i += 1) {
      const axis = [0, 1, 2].find((one) => Math.abs(normal.array[3 * i + one]) > 0.5);
      const [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
      uv.setXY(i, position.array[3 * i + u] / TEXTURE_METRES, position.array[3 * i + v] / TEXTURE_METRES);
      const light = plain ? BAKED[axis] : 1;
      colours.set(tint.toArray().map((value) => light * value), 3 * i);
    }
    box.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    return box;
  });
  const material = plain
    ? new THREE.MeshBasicMaterial({ vertexColors: true })
    : new THREE.MeshLambertMaterial({ vertexColors: true, map: groundTexture() });
  const mesh = new THREE.Mesh(mergeGeometries(parts), material);
  mesh.castShadow = mesh.receiveShadow = !plain;
  return mesh;
}

/** Edges of obstacles. */
function lines(boxes) {
  const points = [];
  for (const { at, half } of boxes.filter((box) => !isWide(box))) {
    const box = new THREE.BoxGeometry(...half.map((value) => 2 * value + 0.002)).translate(...at);
    points.push(...new THREE.EdgesGeometry(box).attributes.position.array);
  }
  return segments(points, { color: 0x1c2229, transparent: true, opacity: 0.55 });
}

/** Joints between the slabs on top of obstacles. */
function joints(boxes) {
  const points = [];
  for (const box of boxes.filter((one) => !isWide(one))) {
    const z = top(box) + RAISED;
    const ends = [0, 1].map((axis) => [-1, 1].map((way) => box.at[axis] + way * box.half[axis]));
    for (const axis of [0, 1]) {
      const [first, last] = ends[axis];
      for (let at = SLAB * Math.ceil(first / SLAB); at < last; at += SLAB) {
        for (const end of ends[1 - axis]) points.push(...(axis ? [end, at, z] : [at, end, z]));
      }
    }
  }
  return segments(points, { color: JOINT });
}

function segments(points, look) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial(look));
}

/** One geometry of many with the same attributes. */
function mergeGeometries(parts) {
  const merged = new THREE.BufferGeometry();
  for (const [name, { itemSize }] of Object.entries(parts[0].attributes)) {
    const all = parts.flatMap((part) => Array.from(part.attributes[name].array));
    merged.setAttribute(name, new THREE.Float32BufferAttribute(all, itemSize));
  }
  let first = 0;
  const indices = parts.flatMap((part) => {
    const own = Array.from(part.index.array, (index) => index + first);
    first += part.attributes.position.count;
    return own;
  });
  return merged.setIndex(indices);
}

/** Speckled concrete with slabs of half a metre. */
function groundTexture() {
  const size = 512;
  const canvas = new OffscreenCanvas(size, size);
  const context = canvas.getContext("2d");
  context.fillStyle = "#e9ebec";
  context.fillRect(0, 0, size, size);
  for (let n = 0; n < 9000; n += 1) {
    const grey = Math.random() < 0.5 ? 20 : 255;
    context.fillStyle = `rgba(${grey}, ${grey}, ${grey}, ${0.05 + 0.1 * Math.random()})`;
    context.fillRect(Math.random() * size, Math.random() * size, 1 + 2 * Math.random(), 1 + Math.random());
  }
  for (let slab = 0; slab < 4; slab += 1) {
    context.fillStyle = slab % 2 ? "#c2c7cb" : "#a4abb1";
    const thick = slab % 2 ? 2 : 3;
    context.fillRect((slab * size) / 4, 0, thick, size);
    context.fillRect(0, (slab * size) / 4, size, thick);
  }
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.anisotropy = 8;
  texture.colorSpace = THREE.SRGBColorSpace;
  return texture;
}
