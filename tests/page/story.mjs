// Tells the story of a robot that walks for some seconds, and then stands; prints its sentence, as JSON.
// Usage: node story.mjs WEB WALKS STANDS

import { pathToFileURL } from "node:url";

const [web, walks, stands] = process.argv.slice(2);
const { Story } = await import(pathToFileURL(`${web}/panel/story.js`));

const DT = 0.02;
const SPEED = 0.5;
const ONSET = 1;
const story = new Story({ obstacle: [20, 21], done: "crossed" }, 1);
const camera = { fault: { onset: ONSET }, broken: (now) => now >= ONSET };
let x = 0;
for (let now = 0; now < Number(walks) + Number(stands); now += DT) {
  const forward = now < Number(walks) ? SPEED : 0;
  x += forward * DT;
  story.note(0, {
    now,
    fell: false,
    state: "remembers",
    world: { pose: () => ({ position: [x, 0, 0.3] }) },
    camera,
    walked: { forward, left: 0, turnRate: 0 },
    controller: { mode: "memory" },
  });
}
console.log(JSON.stringify(story.sentence));
