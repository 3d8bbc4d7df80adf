// A simulated flight and its sensors. No clock and no DOM: the same seed gives the same numbers.

// ---- Quaternions [w, x, y, z] and vectors ----

export const multiply = ([a, b, c, d], [w, x, y, z]) => [
  a * w - b * x - c * y - d * z,
  a * x + b * w + c * z - d * y,
  a * y - b * z + c * w + d * x,
  a * z + b * y - c * x + d * w,
];
export const conjugate = ([w, x, y, z]) => [w, -x, -y, -z];
export const rotated = (q, [x, y, z]) => multiply(multiply(q, [0, x, y, z]), conjugate(q)).slice(1);
export const about = ([x, y, z], angle) => {
  const s = Math.sin(angle / 2);
  return [Math.cos(angle / 2), s * x, s * y, s * z];
};
const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];
export const plus = (a, b, factor = 1) => a.map((each, i) => each + factor * b[i]);
export const norm = (a) => Math.hypot(...a);

/** The rotation vector of a quaternion [rad]. */
function logarithm([w, ...v]) {
  const s = norm(v);
  const factor = s < 1e-12 ? 2 : (2 * Math.atan2(Math.sign(w) * s, Math.abs(w))) / s;
  return v.map((each) => factor * each);
}

/** The angle between two attitudes [rad], 0 to pi. */
export const angleBetween = (a, b) => norm(logarithm(multiply(conjugate(a), b)));

// ---- Random numbers ----

/** Uniform and normal numbers of a seed (sfc32). */
export class Random {
  constructor(seed) {
    this.state = [seed >>> 0, 0x9e3779b9, 0x243f6a88, 1];
    for (let i = 0; i < 16; ++i) this.uniform();
  }
  uniform() {
    let [a, b, c, counter] = this.state;
    const sum = (((a + b) | 0) + counter) | 0;
    a = b ^ (b >>> 9);
    b = (c + (c << 3)) | 0;
    c = (((c << 21) | (c >>> 11)) + sum) | 0;
    this.state = [a, b, c, (counter + 1) | 0];
    return ((sum >>> 0) + 0.5) / 4294967296;
  }
  normal() {
    const radius = Math.sqrt(-2 * Math.log(this.uniform()));
    return radius * Math.cos(2 * Math.PI * this.uniform());
  }
  normals(n) {
    return Array.from({ length: n }, () => this.normal());
  }
  /** A uniformly distributed direction. */
  direction() {
    const v = this.normals(3);
    return v.map((each) => each / norm(v));
  }
}

// ---- The flight ----

const PERIOD = 24; // s, one figure of eight

/** The true pose at time t [s]: a figure of eight that climbs and sinks, the body along it, rolling. */
export function pose(t) {
  const w = (2 * Math.PI) / PERIOD;
  const position = [
    3.6 * Math.sin(w * t),
    2.3 * Math.sin(2 * w * t),
    1.7 + 0.6 * Math.sin(1.5 * w * t),
  ];
  const [x, y, z] = [
    3.6 * w * Math.cos(w * t),
    4.6 * w * Math.cos(2 * w * t),
    0.9 * w * Math.cos(1.5 * w * t),
  ];
  const yaw = about([0, 0, 1], Math.atan2(y, x));
  const pitch = about([0, 1, 0], -Math.atan2(z, Math.hypot(x, y)) + 0.25 * Math.sin(0.5 * t));
  const roll = about([1, 0, 0], 0.9 * Math.sin(0.7 * t));
  return { attitude: multiply(multiply(yaw, pitch), roll), position };
}

/** The constant body velocities that take pose a to pose b in dt: the logarithm of SE(3). */
function velocities(a, b, dt) {
  const w = logarithm(multiply(conjugate(a.attitude), b.attitude));
  const d = rotated(conjugate(a.attitude), plus(b.position, a.position, -1));
  const half = norm(w) / 2;
  const factor = half < 1e-4 ? 1 / 12 : (1 - half / Math.tan(half)) / (4 * half * half);
  const turned = cross(w, d);
  const v = plus(plus(d, turned, -0.5), cross(w, turned), factor);
  return { angular: w.map((each) => each / dt), linear: v.map((each) => each / dt) };
}

const PAUSE = 3; // s, between two bursts

/**
 * The flight with its sensors. `added` is added to the bias of each axis, `sensors` says whether each is
 * "measured", "cut" or "disturbed"; both may be changed at any time.
 */
export class Flight {
  constructor(world, seed) {
    this.world = world;
    this.noise = new Random(seed);
    this.events = new Random(seed + 0x10000);
    this.samples = 0;
    this.added = { angular: 0, linear: 0, vector: 0 };
    this.sensors = { vector1: "measured", vector2: "measured", landmarks: "measured" };
    this.bursts = {};
    this.truth = pose(0);
    this.landmarks = Math.max(...Object.values(world.filters).map((f) => f.landmarks.length));
  }

  get time() {
    return this.samples * this.world.dt;
  }

  /** What is added to a disturbed sensor: a constant for some seconds, nothing for some, in turn. */
  burst(sensor, size) {
    if (this.sensors[sensor] !== "disturbed") {
      delete this.bursts[sensor];
      return [0, 0, 0];
    }
    const { duration } = this.world.bursts;
    let now = this.bursts[sensor];
    if (!now || this.time - now.begin >= duration + PAUSE) {
      now = { begin: this.time, direction: this.events.direction() };
      this.bursts[sensor] = now;
    }
    now.active = this.time - now.begin < duration;
    return now.direction.map((each) => (now.active ? size * each : 0));
  }

  /** The measurements at this time, the velocities those up to the next; then time moves on. */
  step() {
    const { world, truth, samples } = this;
    const next = pose((samples + 1) * world.dt);
    const { angular, linear } = velocities(truth, next, world.dt);
    const toBody = conjugate(truth.attitude);
    const sensed = (value, { bias, noise }, more) =>
      value.map((each, i) => each + bias[i] + noise * this.noise.normal() + more[i]);
    const extra = (size) => [size, size, size];
    const sample = {
      angular: sensed(angular, world.angularVelocity, extra(this.added.angular)),
      linear: sensed(linear, world.velocity, extra(this.added.linear)),
      vectors: world.vectors.map((vector, i) => {
        const burst = this.burst(`vector${i + 1}`, world.bursts.vector);
        const more = i === 0 ? plus(burst, extra(this.added.vector)) : burst;
        return sensed(rotated(toBody, vector.at), vector, more);
      }),
      vectorWeights: world.vectors.map((_, i) => +(this.sensors[`vector${i + 1}`] !== "cut")),
    };
    // Each filter has landmarks of its own; those in the same place of the order share their noise.
    const noises = Array.from({ length: this.landmarks }, () => this.noise.normals(3));
    const burst = this.burst("landmarks", world.bursts.landmark); // on the first one
    sample.landmarksOf = ({ landmarks, landmarkPeriod }) => ({
      values: landmarks.map(({ at, bias, noise }, i) => {
        const seen = rotated(toBody, plus(at, truth.position, -1));
        return seen.map((each, k) => each + bias[k] + noise * noises[i][k] + (i ? 0 : burst[k]));
      }),
      weights: landmarks.map(
        () => +(samples % landmarkPeriod === 0 && this.sensors.landmarks !== "cut"),
      ),
    });
    this.truth = next;
    this.samples += 1;
    return sample;
  }
}
