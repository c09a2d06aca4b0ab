// What the page's camera sees, 1 m ahead of the start of the scenes that links ask for.
// Usage: node view.mjs WEB PAGE LINK...

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [web, page, ...links] = process.argv.slice(2);
const load = (file) => import(pathToFileURL(`${web}/${file}`));
const { default: loadMujoco } = await load("node_modules/@mujoco/mujoco/mujoco.js");
const { World } = await load("world/simulation.js");
const { DepthCamera } = await load("world/camera.js");
const { readScene } = await load("panel/link.js");

const json = async (file) => JSON.parse(await readFile(`${page}/${file}`));
const contract = await json("renet-page.json");
const mujoco = await loadMujoco();
const views = {};
for (const link of links) {
  const { bundle, ground } = readScene(link, contract);
  const manifest = await json(`${bundle.folder}/manifest.json`);
  const world = new World({ mujoco, manifest, contract, bundle }, ground);
  world.data.qpos[world.free] = 1;
  world.mujoco.mj_forward(world.model, world.data);
  const camera = new DepthCamera(world, manifest.camera, contract.camera, 7);
  views[link] = Array.from(camera.depth());
}
console.log(JSON.stringify(views));
