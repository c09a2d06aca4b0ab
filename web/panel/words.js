// A velocity in words.

/** m/s and rad/s below which a component is not worth a word: */
/** of what is asked for, */
export const ASKED = { speed: 0.05, turnRate: 0.05 };
/** and of what is walked, for a gait sways. */
export const WALKED = { speed: 0.15, turnRate: 0.2 };

/**
 * @param {import("../control/steering.js").Velocity} velocity
 * @param {{ speed: number, turnRate: number }} noted `ASKED` or `WALKED`.
 * @returns {string} such as "0.60 m/s ahead, 0.30 m/s left, turns left at 0.80 rad/s"; "stands".
 */
export function velocityWords({ forward, left, turnRate }, noted) {
  const parts = [];
  if (Math.abs(forward) >= noted.speed) {
    parts.push(`${Math.abs(forward).toFixed(2)} m/s ${forward > 0 ? "ahead" : "back"}`);
  }
  if (Math.abs(left) >= noted.speed) {
    parts.push(`${Math.abs(left).toFixed(2)} m/s ${left > 0 ? "left" : "right"}`);
  }
  if (Math.abs(turnRate) >= noted.turnRate) {
    parts.push(`turns ${turnRate > 0 ? "left" : "right"} at ${Math.abs(turnRate).toFixed(2)} rad/s`);
  }
  return parts.join(", ") || "stands";
}
