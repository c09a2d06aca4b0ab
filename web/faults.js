// Fault models by their names in the catalogue; levels, names and durations come from it, too.

import * as combined from "./faults/combined.js";
import * as image from "./faults/image.js";
import * as physical from "./faults/physical.js";
import * as stereo from "./faults/stereo.js";
import * as timing from "./faults/timing.js";

const MODELS = { ...combined, ...image, ...physical, ...stereo, ...timing };
const snake = (name) => name.replace(/(?<!^)[A-Z]/g, (letter) => `_${letter}`).toLowerCase();

/** Classes by name, such as `salt_and_pepper`; bases among them have no name in the catalogue. */
export const FAULTS = Object.fromEntries(
  Object.entries(MODELS).map(([name, model]) => [snake(name), model]),
);
