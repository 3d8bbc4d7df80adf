// What the tests read from the page opened as index.html#test.

import { Run } from "./run.js";

const mean = (values) => values.reduce((sum, each) => sum + each, 0) / values.length;

/** Errors of each filter [deg, m]: settled, after a turn by 150 degrees, and settled again. */
function turned(world, filters) {
  const run = new Run(world, filters, 1);
  const now = () =>
    filters.map((filter) => {
      const [angle, distance] = filter.errors(run.flight.truth);
      return [(angle * 180) / Math.PI, distance];
    });
  const settled = () => {
    const rows = Array.from({ length: 200 }, () => (run.step(1), now()));
    return filters.map((_, i) => [0, 1].map((k) => mean(rows.map((row) => row[i][k]))));
  };
  run.step(1800);
  const before = settled();
  run.startAt(150, 5);
  const after = now();
  run.step(1800);
  const again = settled();
  return Object.fromEntries(
    filters.map(({ name }, i) => [name, { before: before[i], after: after[i], again: again[i] }]),
  );
}

/** Every number that goes into the filters and comes out, base64 of doubles. */
function samples(world, filters, count) {
  const run = new Run(world, filters, 2);
  run.startAt(150, 5);
  const traces = filters.map((filter) => ({
    first: [...filter.output.subarray(0, 7)],
    input: [],
    output: [],
  }));
  const { flight } = run;
  const third = count / 3;
  for (let k = 0; k < count; ++k) {
    flight.sensors.vector1 = k > third ? "disturbed" : "measured";
    flight.sensors.landmarks = k % 700 > 600 ? "cut" : k > 2 * third ? "disturbed" : "measured";
    flight.added.angular = k > 2 * third ? 0.2 : 0;
    run.step(1);
    filters.forEach((filter, i) => {
      traces[i].input.push(...filter.measurement);
      traces[i].output.push(...filter.output);
    });
  }
  const base64 = (numbers) => {
    const bytes = new Uint8Array(Float64Array.from(numbers).buffer);
    let text = "";
    for (let i = 0; i < bytes.length; i += 4096) {
      text += String.fromCharCode(...bytes.subarray(i, i + 4096));
    }
    return btoa(text);
  };
  return Object.fromEntries(
    filters.map(({ name }, i) => [
      name,
      {
        first: base64([world.dt, ...traces[i].first]),
        input: base64(traces[i].input),
        output: base64(traces[i].output),
      },
    ]),
  );
}

export function report(world, filters) {
  const text = JSON.stringify({ turned: turned(world, filters), samples: samples(world, filters, 3000) });
  const element = document.createElement("script");
  element.type = "application/json";
  element.id = "report";
  element.textContent = text;
  document.body.append(element);
}
