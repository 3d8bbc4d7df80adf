// The exported filters: each a WebAssembly module of filter.c and its header.

import { angleBetween, norm, plus } from "./flight.js";

const POSE = 6;

/** One filter, which reads and writes the module's memory. */
export class Filter {
  static async load(name, binary, settings, vectors) {
    const { instance } = await WebAssembly.instantiate(binary, {});
    return new Filter(name, instance.exports, settings, vectors);
  }

  constructor(name, code, settings, vectors) {
    code._initialize?.();
    const view = (at, size) => new Float64Array(code.memory.buffer, at, size);
    Object.assign(this, { name, code, settings, vectors });
    this.measurement = view(code.measurement(), code.measurement_size());
    this.output = view(code.output(), code.output_size());
    const expected = 6 + 4 * (vectors + settings.landmarks.length);
    if (this.measurement.length !== expected) throw Error(`${name}: other sensors than its header`);
  }

  check(status) {
    if (status !== 0) throw Error(`${this.name}: the filter refused a number, status ${status}`);
  }

  start({ attitude, position }) {
    this.check(this.code.start(...attitude, ...position));
  }

  step(sample, dt) {
    const landmarks = sample.landmarksOf(this.settings);
    this.measurement.set([
      ...sample.angular,
      ...sample.linear,
      ...sample.vectors.flat(),
      ...sample.vectorWeights,
      ...landmarks.values.flat(),
      ...landmarks.weights,
    ]);
    this.check(this.code.step(dt));
  }

  get attitude() {
    return [...this.output.subarray(0, 4)];
  }
  get position() {
    return [...this.output.subarray(4, 7)];
  }
  /** Of attitude [rad^2] and position [m^2], by rows, body frame; all NaN if the filter has none. */
  get covariance() {
    const begin = 13 + 3 * this.vectors;
    return this.output.subarray(begin, begin + POSE * POSE);
  }
  /** The gain [1/s], the factor, or the belief in each sensor, by what the filter schedules. */
  get scheduled() {
    const all = this.output.subarray(13 + 3 * this.vectors + POSE * POSE);
    const { scheduled } = this.settings;
    return scheduled === "" ? [] : scheduled === "belief" ? [...all] : [all[0]];
  }
  /** Twice the root of the sum of the variances: attitude [rad] and position [m]. */
  get twoSigma() {
    const sum = (from) => [0, 1, 2].reduce((s, i) => s + this.covariance[7 * (from + i)], 0);
    return [2 * Math.sqrt(sum(0)), 2 * Math.sqrt(sum(3))];
  }
  /** Errors: attitude [rad] and position [m]. */
  errors(truth) {
    return [
      angleBetween(truth.attitude, this.attitude),
      norm(plus(this.position, truth.position, -1)),
    ];
  }
}

export async function loadFilters(world, binaries) {
  return Promise.all(
    Object.entries(world.filters).map(([name, settings]) =>
      Filter.load(name, binaries[name], settings, world.vectors.length),
    ),
  );
}
