// The page: its controls, and the clock that steps the run.

import "./page.css";
import { binaries, world } from "./built.js";
import { report } from "./check.js";
import { loadFilters } from "./filters.js";
import { Plots } from "./plots.js";
import { Run } from "./run.js";
import { View } from "./scene.js";

const LARGEST_FRAME = 0.1; // s; after a longer pause of the browser, time goes on from where it was
const ABOUT = {
  recommended:
    "A Kalman filter that starts anywhere: the fuzzy controller raises the noise that it assumes while the residuals are large.",
  kalman: "An invariant Kalman filter with fixed noises, whose update is iterated, so that it may start anywhere.",
  observer: "The observer on SE(3), whose gain the fuzzy controller sets at each sample. It has no covariance.",
  disturbed: "A Kalman filter in which the fuzzy controller decides how far each sensor is believed.",
};
const SENSORS = { vector1: "Vector 1", vector2: "Vector 2", landmarks: "Landmarks" };
const UNITS = { turn: "deg", move: "m", angular: "rad/s", linear: "m/s", vector: "" };

const $ = (id) => document.getElementById(id);
const element = (tag, properties, ...children) => {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
};

class Page {
  constructor(filters) {
    this.filters = filters;
    this.selected = 0;
    this.paused = false;
    this.owed = 0; // s, simulated time that is not stepped yet
    this.build();
    try {
      const all = Object.values(world.filters).map(({ landmarks }) => landmarks.map(({ at }) => at));
      this.view = new View($("scene"), all.sort((a, b) => b.length - a.length)[0]);
    } catch {
      $("scene").hidden = $("scene-key").hidden = true;
      $("no-webgl").hidden = false;
    }
    this.reset();
    this.colour();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.colour());
  }

  build() {
    this.cells = this.filters.map(({ name }, i) => {
      const radio = element("input", { type: "radio", name: "filter", onchange: () => this.select(i) });
      const swatch = element("span", { className: "swatch" });
      swatch.style.background = `var(--f${i})`;
      const cells = [element("td"), element("td")];
      const row = element("tr", {}, element("th", { scope: "row" }, element("label", {}, radio, swatch, name)), ...cells);
      $("filters").append(row);
      return { radio, row, cells };
    });
    for (const [sensor, title] of Object.entries(SENSORS)) {
      const choices = ["measured", "cut", "disturbed"].map((value) => {
        const onchange = () => (this.run.flight.sensors[sensor] = value);
        return element("label", {}, element("input", { type: "radio", name: sensor, value, onchange }), value);
      });
      const group = element("div", { className: "choices", role: "radiogroup", ariaLabel: title }, ...choices);
      $("sensors").append(element("div", { className: "sensor" }, element("span", {}, title), group));
    }
    for (const [id, unit] of Object.entries(UNITS)) {
      const show = () => {
        document.querySelector(`output[for=${id}]`).textContent = `${$(id).value} ${unit}`;
        if (this.run && id in this.run.flight.added) this.run.flight.added[id] = Number($(id).value);
      };
      $(id).addEventListener("input", show);
      show();
    }
    $("pause").onclick = () => this.pause(!this.paused);
    $("reset").onclick = () => this.reset();
    $("seed").onchange = () => this.reset();
    $("start").onclick = () => this.start(Number($("turn").value), Number($("move").value));
    $("true-start").onclick = () => this.start(0, 0);
    const keys = { p: "pause", r: "reset", t: "start", s: "true-start" };
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.target.matches("select, input[type=number]")) return;
      if (keys[event.key]) $(keys[event.key]).click();
      const number = Number(event.key) - 1;
      if (this.filters[number]) this.select(number);
    });
    const { duration, vector, landmark } = world.bursts;
    for (const [id, value] of Object.entries({ duration, vector, landmark })) {
      $(`burst-${id}`).textContent = value;
    }
  }

  /** Resets everything except the chosen filter and its speed. */
  reset() {
    this.run = new Run(world, this.filters, Number($("seed").value) >>> 0);
    this.run.step(1);
    for (const sensor of Object.keys(SENSORS)) {
      document.querySelector(`input[name=${sensor}][value=measured]`).checked = true;
    }
    for (const id of Object.keys(this.run.flight.added)) {
      $(id).value = 0;
      $(id).dispatchEvent(new Event("input"));
    }
    this.changed = true;
  }

  start(angle, distance) {
    this.run.startAt(angle, distance);
    this.changed = true;
  }

  pause(paused) {
    this.paused = paused;
    $("pause").textContent = paused ? "Go on" : "Pause";
  }

  select(number) {
    this.selected = number;
    this.cells.forEach(({ radio, row }, i) => {
      radio.checked = i === number;
      row.className = i === number ? "selected" : "";
    });
    $("about").textContent = ABOUT[this.filters[number].name];
    this.colour();
  }

  /** The plots and the scene in the colours of the page's style, which follow the system's. */
  colour() {
    const style = getComputedStyle(document.documentElement);
    const get = (name) => style.getPropertyValue(`--${name}`).trim();
    const filters = this.filters.map((_, i) => get(`f${i}`));
    const vectors = [get("v0"), get("v1")];
    this.ownColour = filters[this.selected];
    this.plots?.destroy();
    this.plots = new Plots(
      ["attitude-plot", "position-plot", "schedule-plot"].map($),
      this.filters,
      this.selected,
      { text: get("text"), line: get("line"), filters, schedule: [...vectors, get("f0"), get("f1"), get("f2")] },
      (row) => {
        this.row = row;
        this.changed = true;
      },
    );
    this.view?.colour({ text: get("text"), line: get("line"), body: get("body"), mark: get("mark"), vectors });
    const key = [
      ["body", get("body")],
      [`estimate of ${this.filters[this.selected].name}`, this.ownColour],
      ["measured vector 1", vectors[0]],
      ["measured vector 2", vectors[1]],
      ["landmarks", get("mark")],
    ].map(([name, colour]) => {
      const swatch = element("span", { className: "swatch" });
      swatch.style.background = colour;
      return element("li", {}, swatch, name);
    });
    $("scene-key").replaceChildren(...key);
    this.changed = true;
  }

  write() {
    const { history, flight } = this.run;
    const row = (this.row != null && history[this.row]) || history.at(-1);
    $("when").textContent = `at ${row.time.toFixed(1)} s`;
    $("time").textContent = `${flight.time.toFixed(1)} s`;
    this.cells.forEach(({ cells }, i) => {
      const { attitudeError, positionError } = row.filters[i];
      cells[0].textContent = `${attitudeError.toFixed(1)} deg`;
      cells[1].textContent = `${positionError.toFixed(2)} m`;
    });
  }

  /** One frame, `seconds` after the last one. */
  frame(seconds) {
    if (!this.paused) {
      this.owed += Math.min(seconds, LARGEST_FRAME) * Number($("speed").value);
      const steps = Math.floor(this.owed / world.dt);
      this.owed -= steps * world.dt;
      this.run.step(steps);
      this.changed ||= steps > 0;
    }
    if (this.changed) {
      this.plots.draw(this.run);
      this.write();
      this.changed = false;
    }
    this.view?.draw(this.run, this.selected, this.ownColour);
  }

  animate() {
    let last = performance.now();
    const next = (now) => {
      this.frame(Math.max(0, now - last) / 1000);
      last = now;
      requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
  }

  /**
   * A situation to link to: #filter=observer&at=20&turn=150&move=5&until=20.5 turns at 20 s and
   * stops at 20.5 s; also seed, and a sensor, as vector1=disturbed, from `at` on.
   */
  open(situation) {
    const given = new URLSearchParams(situation);
    const steps = (time) => Math.max(0, Math.round(Number(time) / world.dt) - this.run.flight.samples);
    if (given.has("seed")) $("seed").value = given.get("seed");
    if (given.has("seed")) this.reset();
    this.select(Math.max(0, this.filters.findIndex(({ name }) => name === given.get("filter"))));
    if (given.has("at")) this.run.step(steps(given.get("at")));
    for (const sensor of Object.keys(SENSORS)) {
      document.querySelector(`input[name=${sensor}][value="${given.get(sensor)}"]`)?.click();
    }
    for (const id of ["turn", "move"]) {
      if (!given.has(id)) continue;
      $(id).value = given.get(id);
      $(id).dispatchEvent(new Event("input"));
    }
    if (given.has("turn") || given.has("move")) $("start").click();
    if (given.has("until")) this.run.step(steps(given.get("until")));
    this.pause(given.has("until"));
  }
}

async function main() {
  const filters = await loadFilters(world, binaries);
  const page = new Page(filters);
  page.open(location.hash.slice(1));
  if (location.hash === "#test") report(page, world);
  else page.animate();
}

main().catch((error) => {
  $("failure").hidden = false;
  $("failure").textContent = `This page needs a browser with WebAssembly: ${error.message}`;
  throw error;
});
