// How far the ground reaches that a robot has seen, from its motion since its last image.
// Mirrors `src/renet/pilot/reach.py`.

/** The ground that one robot has seen, in the frame of its base at its last image. */
export class Reach {
  /**
   * @param {object} contract `reach` of the contract: distance and halfWidth of an image, margin within
   *   which ground must have been seen, distance beyond its end at which a robot stops on any ground, all
   *   m; underFeet and stoppingGround, the points of the height map under a robot, and also on its way
   *   until it stands, and the largest relief there, m, on which it stops.
   * @param {number} dt seconds of a control step.
   */
  constructor(contract, dt) {
    const { distance, halfWidth, margin, obstacleEnd, underFeet, stoppingGround, relief } = contract;
    Object.assign(this, { distance, halfWidth, margin, obstacleEnd, underFeet, stoppingGround, relief, dt });
    this.reset();
  }

  /** Begin at a new image. */
  reset() {
    this.x = this.y = this.yaw = 0;
    /** Whether any ground was seen. */
    this.seen = true;
  }

  /** Have seen no ground until the next image. */
  forget() {
    this.seen = false;
  }

  /**
   * Advance the motion by one control step.
   * @param {ArrayLike<number>} velocity ahead and to the left in the base frame, m/s.
   * @param {number} turnRate rad/s.
   */
  move([ahead, left], turnRate) {
    const [x, y] = this.turned(ahead, left);
    this.x += this.dt * x;
    this.y += this.dt * y;
    this.yaw += this.dt * turnRate;
  }

  /**
   * Metres from the base to the end of the ground seen, along a unit vector of its frame; zero: infinite.
   * In any other direction they are -Infinity where no ground was seen.
   */
  ahead([forward, left]) {
    if (!this.seen && (forward !== 0 || left !== 0)) return -Infinity;
    const [along, across] = this.turned(forward, left);
    const toEnd = distance(this.distance - this.x, along);
    // Behind the frame's origin there are no sides: the robot walks back on its own track.
    if (this.x + this.margin * along < 0) return toEnd;
    const toLeft = distance(this.halfWidth - this.y, across);
    const toRight = distance(this.halfWidth + this.y, -across);
    return Math.min(toEnd, toLeft, toRight);
  }

  /** Whether the end of the ground seen is near along a direction, as of `ahead`. */
  ends(direction) {
    return this.ahead(direction) < this.margin;
  }

  /**
   * Whether a robot at the end of the ground seen can stop there; it finishes an obstacle first.
   * @param {number[]} direction as of `ahead`.
   * @param {ArrayLike<number>} heightMap VP's map of the ground around the base, m.
   */
  canStop(direction, heightMap) {
    if (!this.ends(direction)) return false;
    const ahead = this.ahead(direction);
    if (ahead < -this.obstacleEnd) return true;
    // Beyond that end VP only imagines what is ahead.
    if (ahead < 0) return this.standsOnLevelGround(heightMap);
    return this.isLevel(heightMap, this.stoppingGround);
  }

  /** Whether VP's map is level below the robot. */
  standsOnLevelGround(heightMap) {
    return this.isLevel(heightMap, this.underFeet);
  }

  isLevel(heightMap, points) {
    const heights = points.map((point) => heightMap[point]);
    return Math.max(...heights) - Math.min(...heights) < this.relief;
  }

  /** Whether a point of the base frame is on ground that was seen, m. */
  covers(forward, left) {
    const [x, y] = this.turned(forward, left);
    const [ahead, side] = [this.x + x, Math.abs(this.y + y)];
    // At the moment of the image its outermost points count, whatever the rounding.
    const margin = 1e-9;
    const beside = side <= this.halfWidth + margin || ahead < 0;
    return this.seen && ahead <= this.distance + margin && beside;
  }

  /** A vector of the base frame in that of the last image. */
  turned(forward, left) {
    const [cosine, sine] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    return [cosine * forward - sine * left, sine * forward + cosine * left];
  }
}

/** Unit vector in the base frame in which a command leads; zero where it asks to stand. */
export function directionOf([forward, left], told) {
  // Of a heading only the first number is a velocity.
  const side = told === "heading" ? 0 : left;
  const speed = Math.hypot(forward, side);
  return speed > 0 ? [forward / speed, side / speed] : [0, 0];
}

/** A command with a speed of at most `limit` m/s, in the same direction and with the same turn. */
export function slowed(command, told, limit) {
  const parts = told === "heading" ? 1 : 2;
  const speed = Math.hypot(...command.slice(0, parts));
  if (speed <= limit) return command;
  return command.map((value, part) => (part < parts ? (value * limit) / speed : value));
}

/** Metres to a line that is `gap` away along its normal, in a direction of that cosine to it. */
function distance(gap, cosine) {
  return cosine > 1e-6 ? gap / cosine : Infinity;
}
