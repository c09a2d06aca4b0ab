// What the page's camera sees, 1 m ahead of the start, of a scene with a physical fault, before, during and after it.
// Usage: node view.mjs WEB PAGE FAULT SEVERITY

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [web, page, name, severity] = process.argv.slice(2);
const load = (file) => import(pathToFileURL(`${web}/${file}`));
const { default: loadMujoco } = await load("node_modules/@mujoco/mujoco/mujoco.js");
const { World } = await load("simulation.js");
const { DepthCamera } = await load("camera.js");

const json = async (file) => JSON.parse(await readFile(`${page}/${file}`));
const [contract, manifest] = [await json("renet-page.json"), await json("bundle/manifest.json")];
const scene = contract.scenes.find((one) => one.name === "platform");
const world = new World(await loadMujoco(), scene, manifest.robot, contract);
world.data.qpos[world.free] = 1;
world.mujoco.mj_forward(world.model, world.data);
const camera = new DepthCamera(world, manifest.camera, contract.camera, 7);
const look = () => Array.from(camera.depth(0));

const clean = look();
camera.break(contract.faults.find((fault) => fault.name === name), Number(severity), 0);
const { turn = null } = camera.fault.model.view;
const spoilt = look();
camera.repair();
console.log(JSON.stringify({ clean, spoilt, turn, repaired: look() }));
