// The proprioception o_t from a robot's sensors, scaled as in training.
// Mirrors `src/renet/deploy/observation.py`.

/**
 * One robot's o_t.
 * @param {object} state quaternion (w, x, y, z), angularVelocity, jointPosition, jointVelocity.
 * @param {object} robot `robot` of the bundle's manifest.
 * @param {object[]} terms `proprioception` of the contract.
 * @param {number[]} command [3] where the policy is told to go, see steering.js.
 * @param {ArrayLike<number>} lastAction [12] policy units.
 * @returns {Float32Array} [45]
 */
export function observe(state, robot, terms, command, lastAction) {
  const values = {
    base_angular_velocity: state.angularVelocity,
    projected_gravity: projectedGravity(state.quaternion),
    command,
    joint_position: robot.default_position.map((zero, i) => state.jointPosition[i] - zero),
    joint_velocity: state.jointVelocity,
    last_action: lastAction,
  };
  return Float32Array.from(
    terms.flatMap(({ name, scale }) => Array.from(values[name], (value) => scale * value)),
  );
}

/** Unit vector of gravity in the base frame from the base-to-world quaternion. */
export function projectedGravity(quaternion) {
  const length = Math.hypot(...quaternion);
  const [w, x, y, z] = Array.from(quaternion, (part) => part / length);
  return [-2 * (x * z - w * y), -2 * (y * z + w * x), -(1 - 2 * (x * x + y * y))];
}

/** Yaw of the base, rad. */
export function heading([w, x, y, z]) {
  return Math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z);
}
