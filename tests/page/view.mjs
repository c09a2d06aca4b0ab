// What the page's camera sees, 1 m ahead of the start of a ground.
// Usage: node view.mjs WEB PAGE GROUND

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [web, page, name] = process.argv.slice(2);
const load = (file) => import(pathToFileURL(`${web}/${file}`));
const { default: loadMujoco } = await load("node_modules/@mujoco/mujoco/mujoco.js");
const { World } = await load("world/simulation.js");
const { DepthCamera } = await load("world/camera.js");

const json = async (file) => JSON.parse(await readFile(`${page}/${file}`));
const contract = await json("renet-page.json");
const [bundle] = contract.bundles;
const manifest = await json(`${bundle.folder}/manifest.json`);
const ground = bundle.grounds.find((one) => one.name === name);
const world = new World({ mujoco: await loadMujoco(), manifest, contract, bundle }, ground);
world.data.qpos[world.free] = 1;
world.mujoco.mj_forward(world.model, world.data);
const camera = new DepthCamera(world, manifest.camera, contract.camera, 7);
console.log(JSON.stringify(Array.from(camera.depth())));
