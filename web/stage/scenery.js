// The ground as it is simulated: its boxes with texture, edges and shadow, out to the horizon.

import * as THREE from "three";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";

const TEXTURE_METRES = 2;
/** Side of the ground that the texture covers once. */
const FLOOR = 0xa9b58f;
const JOINT = 0x8a9674;
const FAR = [8, 45];
/** Metres from the eye at which haze begins and ends. */
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

const NIGHT = 0.45;
/** Share of the day's light on the ground in a dark page. */

/** Whether the visitor prefers dark pages. */
export const dark = matchMedia("(prefers-color-scheme: dark)");

/** Haze in the colour of the page's horizon, by day or in the dark. */
export function haze() {
  const colour = getComputedStyle(document.documentElement).getPropertyValue("--haze");
  return new THREE.Fog(colour.trim(), ...FAR);
}

const top = ({ at, half }) => at[2] + half[2];
const isWide = ({ half }) => Math.max(...half) >= WIDE;

/**
 * The terrain as a group, and functions: of the height of the ground, to be called with the position
 * of the robot that is drawn next, and to be called once the page has become dark or light.
 * @param {object} world a `World`.
 * @param {number[]} seenGroups whether the camera sees each geom group.
 * @param {boolean} plain light is in the colours, and lines stand for texture: for browsers that draw
 *   without a GPU, where texture and light of each pixel take most of a picture.
 */
export function buildTerrain(world, seenGroups, plain) {
  const boxes = findBoxes(world, seenGroups);
  const group = new THREE.Group();
  const ground = solid(boxes, plain);
  group.add(ground, edges(boxes));
  const shaded = [ground.material];
  let follow = () => {};
  if (plain) {
    const floor = Math.max(...boxes.filter(isWide).map(top));
    const around = new THREE.GridHelper(SLABS * SLAB, SLABS, JOINT, JOINT).rotateX(Math.PI / 2);
    const slab = (at) => SLAB * Math.round(at / SLAB);
    follow = ([x, y]) => around.position.set(slab(x), slab(y), floor + RAISED);
    group.add(around);
    shaded.push(around.material);
  }
  const shade = () => shaded.forEach(({ color }) => color.setScalar(dark.matches ? NIGHT : 1));
  shade();
  return { group, heightAt: (x, y) => heightAt(boxes, x, y), follow, shade };
}

function findBoxes({ model, data, mujoco }, seenGroups) {
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
  return boxes;
}

/** Highest surface above a point, or minus infinity. */
function heightAt(boxes, x, y) {
  const under = boxes.filter(
    ({ at, half }) => Math.abs(x - at[0]) <= half[0] && Math.abs(y - at[1]) <= half[1],
  );
  return Math.max(...under.map(top));
}

/** All boxes as one mesh, so that they are one call to draw. */
function solid(boxes, plain) {
  const parts = boxes.map((box) => {
    const { at, half, colour } = box;
    const geometry = new THREE.BoxGeometry(...half.map((value) => 2 * value)).translate(...at);
    const { position, normal, uv } = geometry.attributes;
    const tint = isWide(box) ? new THREE.Color(FLOOR) : colour;
    const colours = new Float32Array(3 * position.count);
    for (let i = 0; i < position.count; i += 1) {
      const axis = [0, 1, 2].find((one) => Math.abs(normal.array[3 * i + one]) > 0.5);
      const [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
      uv.setXY(i, position.array[3 * i + u] / TEXTURE_METRES, position.array[3 * i + v] / TEXTURE_METRES);
      tint.clone().multiplyScalar(plain ? BAKED[axis] : 1).toArray(colours, 3 * i);
    }
    geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    return geometry;
  });
  const material = plain
    ? new THREE.MeshBasicMaterial({ vertexColors: true })
    : new THREE.MeshLambertMaterial({ vertexColors: true, map: groundTexture() });
  const mesh = new THREE.Mesh(mergeGeometries(parts), material);
  mesh.castShadow = mesh.receiveShadow = !plain;
  return mesh;
}

/** Edges of obstacles. */
function edges(boxes) {
  const points = boxes
    .filter((box) => !isWide(box))
    .flatMap(({ at, half }) => {
      const box = new THREE.BoxGeometry(...half.map((value) => 2 * value + 0.002)).translate(...at);
      return Array.from(new THREE.EdgesGeometry(box).attributes.position.array);
    });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  const ink = { color: 0x1c2229, transparent: true, opacity: 0.5 };
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial(ink));
}

/** Speckled ground with slabs of half a metre. */
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
  context.fillStyle = "#b4bac0";
  for (let slab = 0; slab < size; slab += (size * SLAB) / TEXTURE_METRES) {
    context.fillRect(slab, 0, 2, size);
    context.fillRect(0, slab, size, 2);
  }
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.anisotropy = 8;
  texture.colorSpace = THREE.SRGBColorSpace;
  return texture;
}
