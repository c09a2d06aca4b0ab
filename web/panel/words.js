// A velocity in words.

const NOTED = { speed: 0.05, turnRate: 0.1 };
/** m/s and rad/s below which a component is not worth a word. */

/**
 * @param {import("../control/steering.js").Velocity} velocity
 * @returns {string} such as "0.60 m/s ahead, 0.30 m/s left, turns left at 0.80 rad/s"; "stands".
 */
export function velocityWords({ forward, left, turnRate }) {
  const parts = [];
  if (Math.abs(forward) >= NOTED.speed) {
    parts.push(`${Math.abs(forward).toFixed(2)} m/s ${forward > 0 ? "ahead" : "back"}`);
  }
  if (Math.abs(left) >= NOTED.speed) {
    parts.push(`${Math.abs(left).toFixed(2)} m/s ${left > 0 ? "left" : "right"}`);
  }
  if (Math.abs(turnRate) >= NOTED.turnRate) {
    parts.push(`turns ${turnRate > 0 ? "left" : "right"} at ${Math.abs(turnRate).toFixed(2)} rad/s`);
  }
  return parts.join(", ") || "stands";
}
