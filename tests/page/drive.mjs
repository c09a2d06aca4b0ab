// Drives the page's robot without drawing it; prints the velocity that it walks, as JSON.
// Usage: node drive.mjs WEB PAGE LINK MODE FORWARD,LEFT,TURN_RATE...

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [web, page, link, mode, ...asked] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(`${web}/${name}`));
const { loadModels, loadRuntime } = await load("load.js");
const { readScene } = await load("panel/link.js");
const { Simulation } = await load("world/simulation.js");

const BEGUN = 4;
/** Seconds after which a robot walks as it is asked to. */
const ENOUGH = 7;
/** Seconds up to which its velocity is averaged: a gait sways. */
const read = async (path) => new Uint8Array(await readFile(`${page}/${path}`));
const contract = JSON.parse(await readFile(`${page}/renet-page.json`));
const { bundle, ground } = readScene(link, contract);
const runtime = await loadRuntime(read, contract, bundle);
await loadModels(runtime, read);

async function drive([forward, left, turnRate]) {
  const simulation = new Simulation(runtime, ground, 1, mode);
  const walked = { forward: 0, left: 0, turnRate: 0 };
  const steps = (ENOUGH - BEGUN) / contract.controlDt;
  while (simulation.now < ENOUGH) {
    await simulation.step({ forward, left, turnRate });
    if (simulation.now < BEGUN) continue;
    for (const [component, value] of Object.entries(simulation.world.baseVelocity())) {
      walked[component] += value / steps;
    }
  }
  const { fell } = simulation;
  simulation.delete();
  return { ...walked, fell };
}

const told = [];
for (const velocity of asked) told.push(await drive(velocity.split(",").map(Number)));
console.log(JSON.stringify(told));
