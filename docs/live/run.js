// A flight and all filters on its measurements, and what the plots show of them.

import { Flight, Random, about, multiply, plus } from "./flight.js";

const EVERY = 5; // samples, from one row of the history to the next
const KEPT = 30; // s

export class Run {
  constructor(world, filters, seed) {
    Object.assign(this, { world, filters, seed });
    this.flight = new Flight(world, seed);
    this.starts = new Random(seed + 0x20000);
    this.history = [];
    this.started = 0; // how often
    this.startAt(0, 0);
  }

  /** Restarts each filter, turned from the truth by an angle [deg] and moved by a distance [m]. */
  startAt(angle, distance) {
    const { attitude, position } = this.flight.truth;
    const turn = about(this.starts.direction(), (angle * Math.PI) / 180);
    const start = {
      attitude: multiply(attitude, turn),
      position: plus(position, this.starts.direction(), distance),
    };
    for (const filter of this.filters) filter.start(start);
    this.started += 1;
    this.record();
  }

  /** `n` samples: everything that the page animates, without its clock. */
  step(n) {
    for (; n > 0; --n) {
      const sample = this.flight.step();
      for (const filter of this.filters) filter.step(sample, this.world.dt);
      this.sample = sample;
      if (this.flight.samples % EVERY === 0) this.record();
    }
  }

  record() {
    const { truth, time, sensors } = this.flight;
    const positive = (value) => (Number.isFinite(value) ? Math.max(value, 1e-9) : null);
    this.history.push({
      time,
      started: this.started,
      position: truth.position,
      filters: this.filters.map((filter) => {
        const [angle, distance] = filter.errors(truth);
        const [angleSigma, distanceSigma] = filter.twoSigma;
        return {
          position: filter.position,
          attitudeError: positive((angle * 180) / Math.PI),
          attitudeSigma: positive((angleSigma * 180) / Math.PI),
          positionError: positive(distance),
          positionSigma: positive(distanceSigma),
          scheduled: filter.scheduled.map((value, i) =>
            filter.settings.scheduled === "belief" && cut(sensors, i) ? null : positive(value),
          ),
        };
      }),
    });
    while (this.history[0].time < time - KEPT) this.history.shift();
  }
}

const cut = (sensors, i) => (sensors[`vector${i + 1}`] ?? sensors.landmarks) === "cut";
