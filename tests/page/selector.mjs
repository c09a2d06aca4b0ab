// Gives a sequence of what is known of vision to the page's selector; prints what it decides as JSON.
// Usage: node selector.mjs WEB INPUT

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [web, file] = process.argv.slice(2);
const { Selector } = await import(pathToFileURL(`${web}/control/selector.js`));
const { spec, contract, images, steps } = JSON.parse(await readFile(file));
const pictures = images.map((image) => Float32Array.from(image));
const selector = new Selector(spec, contract);
// Infinite numbers are not JSON.
const number = (value) => (value === null ? Infinity : value);

let image = null;
const decided = steps.map(({ now, tick, picture, scores, ...seen }) => {
  if (tick && seen.fresh) image = pictures[picture].slice();
  const given = { ...seen, image };
  for (const [name, value] of Object.entries(scores)) given[name] = number(value);
  const gate = tick ? selector.look(given)(given) : null;
  const vision = selector.update(given, now);
  return { gate, vision, state: selector.state, reason: selector.reason, probability: selector.probability };
});
console.log(JSON.stringify(decided));
