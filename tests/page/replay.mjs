// Replays a recorded sequence through the page's controller; prints what it decided as JSON.
// Usage: node replay.mjs WEB PAGE SEQUENCE

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [web, page, file] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(`${web}/${name}`));
const { loadModels, loadRuntime } = await load("load.js");
const { Controller } = await load("control/controller.js");

const read = async (path) => new Uint8Array(await readFile(`${page}/${path}`));
const contract = JSON.parse(await readFile(`${page}/renet-page.json`));
const runtime = await loadRuntime(read, contract, contract.bundles[0]);
await loadModels(runtime, read);
const { mode, unseen, ticks } = JSON.parse(await readFile(file));
const controller = new Controller(runtime, mode, unseen);

function image(text) {
  const { buffer, byteOffset, length } = Buffer.from(text, "base64");
  return new Float32Array(buffer.slice(byteOffset, byteOffset + length));
}

function mapSeen() {
  const { x, y } = contract.heightMap;
  return x.flatMap((ahead) => y.map((left) => controller.hasSeen(ahead, left)));
}

const decided = [];
let frame = null;
for (const { state, frame: next, teleop, now } of ticks) {
  if (next) frame = { ...next, image: image(next.image) };
  const command = await controller.tick(state, frame, teleop, now);
  const { phase, policy, selector, observation, action, driving } = controller;
  decided.push({
    phase,
    ...command,
    observation: Array.from(observation ?? []),
    action: Array.from(action),
    latent_op: Array.from(policy.latentOp),
    latent_vp: Array.from(policy.latentVp),
    height_map: Array.from(policy.heightMap ?? []),
    anomaly: policy.anomalyScore,
    surprise: policy.surprise,
    stillness: policy.stillness,
    probability: selector.probability,
    vision: driving !== "blind",
    reason: selector.reason,
    state: selector.state,
    map_error: policy.mapError,
    unseen: controller.unseen,
    map_seen: phase === "walking" ? mapSeen() : [],
  });
}
console.log(JSON.stringify(decided));
