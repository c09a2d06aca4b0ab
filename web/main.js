// Loads the page, and lets its time pass.

import { countingReader, loadContract, loadModels, loadRuntime } from "./load.js";
import { Page } from "./page.js";
import { readScene } from "./panel/link.js";
import { loadLook } from "./stage/robot.js";

const MOST_BEHIND = 0.4;
/** Seconds of simulation that are made up for; beyond, time runs slower than the clock. */
const BEHIND = 0.15;
/** Seconds of simulation from which pictures are rare, */
const RARELY = 250;
/** as many milliseconds apart. */

const stats = { simulated: 0, seconds: 0, pictures: 0, behind: 0, loaded: 0 };
const message = document.querySelector("#message");
/** Hidden from screen readers, which would read out every per cent. */
const percent = Object.assign(document.createElement("span"), { ariaHidden: "true" });
message.append(percent);
let page;

function say(words) {
  if (message.textContent !== words) message.textContent = words;
}

function sleep(milliseconds) {
  return new Promise((resolve) => setTimeout(resolve, milliseconds));
}

/** Simulate in real time, however long pictures take; time stands still while nobody looks. */
async function simulate() {
  const { controlDt } = page.runtime.contract;
  let last = performance.now();
  let debt = 0;
  for (;;) {
    await sleep(4);
    const now = performance.now();
    const passed = (page.pace * (now - last)) / 1000;
    last = now;
    if (document.hidden) continue;
    stats.seconds += passed;
    debt = Math.min(debt + passed, MOST_BEHIND);
    stats.behind = debt;
    for (; debt >= controlDt; debt -= controlDt) {
      await page.step();
      stats.simulated += controlDt;
    }
  }
}

/** Draw as often as the view asks for; a simulation that falls behind comes first. */
async function draw() {
  let last = performance.now();
  // No pictures come while nobody looks, which says nothing about how quickly they are drawn.
  document.addEventListener("visibilitychange", () => (last = performance.now()));
  for (;;) {
    const pause = stats.behind > BEHIND ? RARELY : page.view.pause;
    if (pause > 0) await sleep(pause);
    const now = await new Promise(requestAnimationFrame);
    page.draw(Math.max(now - last, 1) / 1000);
    if (stats.ready) say(page.message);
    last = now;
    stats.pictures += 1;
    stats.first ??= performance.now();
  }
}

async function walk(read) {
  while (!stats.first) await sleep(1);
  await loadModels(page.runtime, read);
  stats.ready = performance.now();
  // What was to be read while the models came is read from now on.
  if (page.notice) page.notify(page.notice);
  await simulate();
}

try {
  const contract = await loadContract();
  const scene = readScene(location.search, contract);
  const read = countingReader(contract.sizes, scene.bundle, (share) => {
    stats.loaded = share;
    percent.textContent = ` ${Math.floor(100 * share)} %`;
  });
  const runtime = await loadRuntime(read, contract, scene.bundle);
  runtime.look = scene.bundle.look && (await loadLook(await read(scene.bundle.look)));
  page = new Page(runtime, scene);
  globalThis.renetPage = { page, stats };
  await Promise.all([draw(), walk(read)]);
} catch (error) {
  stats.ready = false;
  say(`The page cannot run here: ${error.message}`);
  throw error;
}
