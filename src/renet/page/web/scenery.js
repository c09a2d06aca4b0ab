// The ground as it is simulated: its boxes with texture, edges and shadow.

import * as THREE from "three";

const TEXTURE_METRES = 2;
/** Side of the ground that the texture covers once. */
const FLOOR = 0xb9c2c9;
const WIDE = 5;
/** Half-size in m from which a box is ground rather than an obstacle, and gets no edges. */

/** Meshes of every geom that the camera can see, and a function for the height of the ground. */
export function buildTerrain(world, mujoco, seenGroups, fine) {
  const { model, data } = world;
  const group = new THREE.Group();
  const texture = groundTexture(fine);
  const boxes = [];
  for (let geom = 0; geom < model.ngeom; geom += 1) {
    if (!seenGroups[model.geom_group[geom]]) continue;
    const size = Array.from(model.geom_size.slice(3 * geom, 3 * geom + 3));
    const at = Array.from(data.geom_xpos.slice(3 * geom, 3 * geom + 3));
    const rgba = model.geom_rgba.slice(4 * geom, 4 * geom + 3);
    const plane = model.geom_type[geom] === mujoco.mjtGeom.mjGEOM_PLANE.value;
    const half = plane ? [40, 40, 0.5] : size;
    if (plane) at[2] -= 0.5;
    boxes.push({ at, half });
    group.add(texturedBox(at, half, new THREE.Color().setRGB(...rgba, THREE.SRGBColorSpace), texture));
    if (Math.max(...half) < WIDE) group.add(edges(at, half));
  }
  return { group, heightAt: (x, y) => heightAt(boxes, x, y) };
}

/** Highest surface above a point, or minus infinity. */
function heightAt(boxes, x, y) {
  let top = -Infinity;
  for (const { at, half } of boxes) {
    if (Math.abs(x - at[0]) <= half[0] && Math.abs(y - at[1]) <= half[1]) {
      top = Math.max(top, at[2] + half[2]);
    }
  }
  return top;
}

function texturedBox(at, half, colour, map) {
  const geometry = new THREE.BoxGeometry(...half.map((value) => 2 * value));
  const { position, normal, uv } = geometry.attributes;
  for (let i = 0; i < position.count; i += 1) {
    const place = [0, 1, 2].map((axis) => position.array[3 * i + axis] + at[axis]);
    const facing = [0, 1, 2].map((axis) => Math.abs(normal.array[3 * i + axis]));
    const axis = facing.indexOf(Math.max(...facing));
    const [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
    uv.setXY(i, place[u] / TEXTURE_METRES, place[v] / TEXTURE_METRES);
  }
  const tint = colour.lerp(new THREE.Color(FLOOR), half[0] > WIDE ? 0.6 : 0.2);
  const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: tint, map }));
  mesh.position.set(...at);
  mesh.receiveShadow = true;
  mesh.castShadow = half[0] < WIDE;
  return mesh;
}

function edges(at, half) {
  const box = new THREE.BoxGeometry(...half.map((value) => 2 * value + 0.002));
  const lines = new THREE.LineSegments(
    new THREE.EdgesGeometry(box),
    new THREE.LineBasicMaterial({ color: 0x1c2229, transparent: true, opacity: 0.55 }),
  );
  lines.position.set(...at);
  return lines;
}

/** Speckled concrete with slabs of half a metre. */
function groundTexture(fine) {
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
  texture.anisotropy = fine ? 8 : 1;
  if (!fine) texture.minFilter = THREE.LinearMipmapNearestFilter;
  texture.colorSpace = THREE.SRGBColorSpace;
  return texture;
}
