// Walks the page's opening scene without drawing it; prints what the page would say, as JSON.
// Usage: node opening.mjs WEB PAGE LINK MODE SEED...

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [web, page, link, mode, ...seeds] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(`${web}/${name}`));
const { loadModels, loadRuntime } = await load("load.js");
const { readScene } = await load("panel/link.js");
const { BEFORE, Story } = await load("panel/story.js");
const { SHOW } = await load("panel/driver.js");
const { Simulation } = await load("world/simulation.js");

const LIMIT = 16;
/** Seconds after which a story must be told. */
const AIM = 0.1;
/** Largest angle from straight at the obstacle at the start, rad. */
const read = async (path) => new Uint8Array(await readFile(`${page}/${path}`));
const contract = JSON.parse(await readFile(`${page}/renet-page.json`));
const { bundle, ground, fault, severity } = readScene(link, contract);
const runtime = await loadRuntime(read, contract, bundle);
await loadModels(runtime, read);

async function walk(seed) {
  const simulation = new Simulation(runtime, ground, seed, mode);
  const { world, camera } = simulation;
  const turn = AIM * Math.sin(seed);
  world.data.qpos.set([Math.cos(turn / 2), 0, 0, Math.sin(turn / 2)], world.free + 3);
  const story = new Story(ground, 1);
  while (!story.sentence && simulation.now < LIMIT) {
    const reach = Math.max(...world.pose().position.slice(0, 2).map(Math.abs));
    if (!camera.fault && reach >= ground.obstacle[0] - BEFORE * SHOW.forward) camera.break(fault, severity, simulation.now);
    await simulation.step(SHOW);
    story.note(0, simulation);
  }
  simulation.delete();
  return story.sentence;
}

const told = { left: bundle.opening.left, ground: ground.name, fault: fault.name, sentences: [] };
for (const seed of seeds) told.sentences.push(await walk(Number(seed)));
console.log(JSON.stringify(told));
