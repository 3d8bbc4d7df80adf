// The plots: errors of all filters with the two sigma of the selected one, and its schedule.

import uPlot from "uplot";

const SHOWN = 30; // s

/** What is plotted of each kind of schedule: title, range and the names of its lines. */
const SCHEDULES = {
  gain: { title: "Gain [1/s]", range: [1, 100], names: ["gain"] },
  unknown: { title: "Factor on the noise that it assumes", range: [1, 3000], names: ["factor"] },
  belief: {
    title: "Belief: factor on 1 / variance",
    range: [1e-6, 1],
    names: ["vector 1", "vector 2", "landmark 1", "landmark 2", "landmark 3"],
  },
};

const power = (value) => {
  const exponent = Math.round(Math.log10(value));
  return Math.abs(exponent) > 3 ? `1e${exponent}` : `${value}`;
};

/** The powers of ten within a range. */
function decades([smallest, largest]) {
  const first = Math.round(Math.log10(smallest));
  const count = Math.floor(Math.log10(largest) + 1e-9) - first + 1;
  return Array.from({ length: count }, (_, i) => Number(`1e${first + i}`));
}

class Plot {
  constructor(element, title, entries, range, series, colours, read) {
    this.read = read;
    this.span = [0, SHOWN];
    element.replaceChildren();
    const heading = document.createElement("h3");
    heading.append(title);
    for (const { name, colour, dash } of entries) {
      const item = document.createElement("small");
      item.innerHTML = `<svg width="28" height="12" aria-hidden="true"><path d="M0 7h26" stroke="${colour}"
        stroke-width="2.5" ${dash ? 'stroke-dasharray="6 4"' : ""}/></svg> `;
      item.append(name);
      heading.append(" ", item);
    }
    element.append(heading);
    this.element = element;
    const font = "13px system-ui, sans-serif";
    const axis = { stroke: colours.text, font, grid: { stroke: colours.line, width: 1 }, ticks: { show: false } };
    this.plot = new uPlot(
      {
        width: element.clientWidth,
        height: this.height,
        legend: { show: false },
        cursor: { sync: { key: "time" }, drag: { x: false, y: false }, points: { show: false } },
        scales: { x: { time: false, range: () => this.span }, y: { distr: 3, range: () => range } },
        padding: [8, 20, 0, 0],
        axes: [
          { ...axis, size: 26, values: (_, all) => all.map((value) => `${value} s`) },
          { ...axis, size: 52, splits: () => decades(range), values: (_, all) => all.map(power) },
        ],
        series: [{}, ...series.map((each) => ({ ...each, points: { show: false }, spanGaps: false }))],
        hooks: { setCursor: [(plot) => this.onCursor?.(plot.cursor.idx)] },
      },
      [[0], ...series.map(() => [null])],
      element,
    );
  }

  get height() {
    return Math.round(Math.min(250, Math.max(170, innerHeight * 0.235)));
  }

  draw(run) {
    const { time } = run.flight;
    this.span = [Math.max(0, time - SHOWN), Math.max(SHOWN, time)];
    if (this.plot.width !== this.element.clientWidth || this.plot.height !== this.height) {
      this.plot.setSize({ width: this.element.clientWidth, height: this.height });
    }
    this.plot.setData([run.history.map((row) => row.time), ...this.read(run.history)]);
  }

  destroy() {
    this.plot.destroy();
  }
}

/** All three for a selected filter. `colours`: text, line, filters, schedule. */
export class Plots {
  constructor(elements, filters, selected, colours, onCursor) {
    const kind = filters[selected].settings.scheduled;
    const hasSigma = kind !== "gain";
    const colour = colours.filters[selected];
    const order = filters.map((_, i) => i).filter((i) => i !== selected).concat(selected);
    const errors = (element, title, range, error, sigma) => {
      const series = order.map((i) => ({ stroke: colours.filters[i], width: i === selected ? 2.5 : 1.2 }));
      const entries = []; // the table above has the filters' colours
      if (hasSigma) {
        series.push({ stroke: colour, width: 2, dash: [6, 4] });
        entries.push({ name: `two sigma of ${filters[selected].name}`, colour, dash: true });
      }
      return new Plot(element, title, entries, range, series, colours, (history) => [
        ...order.map((i) => history.map((row) => row.filters[i][error])),
        ...(hasSigma ? [history.map((row) => row.filters[selected][sigma])] : []),
      ]);
    };
    const scheduled = (element) => {
      const { title, range, names } = SCHEDULES[kind];
      const lines = names.map((name, i) => ({
        name,
        colour: names.length === 1 ? colour : colours.schedule[i],
      }));
      const series = lines.map((line) => ({ stroke: line.colour, width: 2 }));
      return new Plot(element, title, lines, range, series, colours, (history) =>
        lines.map((_, i) => history.map((row) => row.filters[selected].scheduled[i])),
      );
    };
    this.all = [
      errors(elements[0], "Attitude error [deg]", [0.1, 180], "attitudeError", "attitudeSigma"),
      errors(elements[1], "Position error [m]", [0.01, 20], "positionError", "positionSigma"),
    ];
    elements[2].replaceChildren();
    if (kind in SCHEDULES) this.all.push(scheduled(elements[2]));
    for (const each of this.all) each.onCursor = onCursor;
  }

  draw(run) {
    for (const each of this.all) each.draw(run);
  }

  destroy() {
    for (const each of this.all) each.destroy();
  }
}
