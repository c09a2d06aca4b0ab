// Gives images to every fault of the page; prints summaries of what is delivered as JSON.
// Usage: node faults.mjs WEB PAGE INPUT

import { readFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const [web, page, file] = process.argv.slice(2);
const { FAULTS } = await import(pathToFileURL(`${web}/world/faults.js`));
const { Random } = await import(pathToFileURL(`${web}/world/random.js`));
const contract = JSON.parse(await readFile(`${page}/renet-page.json`));
const { frames, streams, severities } = JSON.parse(await readFile(file));

/** As `summary` of test_faults.py. */
function summary(before, { image, invalid, fresh, age }) {
  const of = (value) => Array.from(image, value).reduce((sum, part) => sum + part, 0) / image.length;
  const mean = of((value) => value);
  return [
    mean,
    Math.sqrt(of((value) => (value - mean) ** 2)),
    of((value) => Number(value === 0)),
    of((value) => Number(value === 1)),
    of((value, i) => Number(Math.abs(value - before[i]) > 1e-6)),
    of((value, i) => value * Math.floor(i / 64)) / 48,
    of((value, i) => value * (i % 64)) / 64,
    invalid,
    Number(fresh),
    age,
  ];
}

function run(name, level, seed) {
  const fault = new FAULTS[name](level, new Random(seed), contract.camera);
  return frames.flatMap(({ image, elapsed }) => {
    const frame = { image: Float32Array.from(image), fresh: true, age: 0, invalid: 0 };
    const after = fault.corrupt(frame, elapsed);
    return elapsed < 0 ? [] : [summary(frame.image, after)];
  });
}

const delivered = {};
for (const { name, levels } of contract.faults) {
  delivered[name] = severities.map((severity) =>
    Array.from({ length: streams[name] }, (_, seed) =>
      run(name, levels[severity - 1] ?? Infinity, seed + 1),
    ),
  );
}
console.log(JSON.stringify(delivered));
