// What the tests read from the page opened as index.html#test.

import { Run } from "./run.js";

const mean = (values) => values.reduce((sum, each) => sum + each, 0) / values.length;

/** Errors of each filter [deg, m]: settled, after a turn by 150 degrees, and settled again. */
function turned(page) {
  const { run, filters } = page;
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
  for (const [id, value] of Object.entries({ turn: 150, move: 5 })) {
    const slider = document.getElementById(id);
    slider.value = value;
    slider.dispatchEvent(new Event("input"));
  }
  document.getElementById("start").click();
  const after = now();
  run.step(1800);
  const again = settled();
  return Object.fromEntries(
    filters.map(({ name }, i) => [name, { before: before[i], after: after[i], again: again[i] }]),
  );
}

/** What the page says of each filter when it is selected: a row of the table. */
function selected(page) {
  return [...document.querySelectorAll("input[name=filter]")].map((radio) => {
    radio.click();
    page.frame(0.02);
    return document.querySelector("tr.selected").innerText;
  });
}

/** Every number that goes into the filters, and each tenth time all that come out, base64 of doubles. */
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
      if (k % 10 === 9) traces[i].output.push(...filter.output);
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

export function report(page, world) {
  const found = { turned: turned(page), selected: selected(page) };
  found.samples = samples(world, page.filters, 3000);
  const element = document.createElement("script");
  element.type = "application/json";
  element.id = "report";
  element.textContent = JSON.stringify(found);
  document.body.append(element);
}
