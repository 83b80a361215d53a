// A line chart over time: uPlot (vendor/) with our colours, drawn anew where the scheme or the width changes.

import { el } from "./dom.js";

const HEIGHT = 150;
const dark = matchMedia("(prefers-color-scheme: dark)");
const charts = new Set();

dark.addEventListener("change", () => charts.forEach((each) => each.remake()));

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** `series`: [{label, colour, dash, width}], `band`: [index of high, index of low] among them, `limits`: lines across. */
export class Chart {
  constructor(host, { title, unit, series, band, limits = [], onPick }) {
    Object.assign(this, { title, unit, series, band, limits, onPick });
    this.values = el("span", { class: "values" });
    this.plot = el("div", { class: "plot", role: "img", "aria-label": title });
    this.figure = el("figure", {}, el("figcaption", {}, el("b", {}, `${title} [${unit}]`), this.values), this.plot);
    host.append(this.figure);
    this.data = [[], ...series.map(() => [])];
    this.at = null;
    this.observer = new ResizeObserver(() => this._fit());
    this.observer.observe(this.plot);
    charts.add(this);
    this.remake();
  }

  /** `data`: [t_s, ...one column a series]; `at` [s] is the time that is shown; `values` and `text` say it in words. */
  set(data, at, values, text) {
    this.data = data;
    this.at = at;
    this.values.replaceChildren(...values);
    if (this.plot.getAttribute("aria-label") !== text) this.plot.setAttribute("aria-label", text);
    this.uplot.setData(data);
  }

  remake() {
    this.uplot?.destroy();
    const axis = { stroke: () => colour("soft"), grid: { stroke: colour("grid"), width: 1 }, ticks: { show: false }, font: "12px system-ui" };
    this.uplot = new uPlot({
      width: Math.max(100, this.plot.clientWidth), height: HEIGHT, legend: { show: false }, padding: [6, 8, 0, 0],
      cursor: { drag: { x: false, y: false }, points: { show: false }, y: false },
      scales: { x: { time: false }, y: { range: (_, low, high) => this._range(low, high) } },
      axes: [
        { ...axis, size: 26, values: (_, splits) => splits.map((t) => `${Math.floor(t / 60)}:${String(Math.round(t % 60)).padStart(2, "0")}`), incrs: [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600] },
        { ...axis, size: 52, space: 28 },
      ],
      series: [{}, ...this.series.map((each) => ({
        label: each.label, stroke: each.colour ? colour(each.colour) : "transparent", width: each.width ?? 1.5, dash: each.dash, points: { show: false },
      }))],
      bands: this.band ? [{ series: this.band, fill: colour("band") }] : [],
      hooks: { draw: [(u) => this._lines(u)], ready: [(u) => u.over.addEventListener("click", () => this._picked(u))] },
    }, this.data, this.plot);
  }

  remove() {
    this.observer.disconnect();
    charts.delete(this);
    this.uplot.destroy();
    this.figure.remove();
  }

  _fit() {
    const width = this.plot.clientWidth;
    if (width && width !== this.uplot.width) this.uplot.setSize({ width, height: HEIGHT });
  }

  _range(low, high) {
    const all = [low, high, ...this.limits].filter((each) => Number.isFinite(each));
    if (!all.length) return [0, 1];
    const [least, most] = [Math.min(...all), Math.max(...all)];
    const room = Math.max((most - least) * 0.08, Math.abs(most) * 1e-3, 1e-6);
    return [least - room, most + room];
  }

  _lines(u) {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.lineWidth = devicePixelRatio;
    for (const limit of this.limits) {
      const y = u.valToPos(limit, "y", true);
      this._line(ctx, colour("fault"), [8, 4], bbox.left, y, bbox.left + bbox.width, y);
    }
    if (this.at !== null) {
      const x = u.valToPos(this.at, "x", true);
      if (x >= bbox.left && x <= bbox.left + bbox.width) this._line(ctx, colour("ink"), [], x, bbox.top, x, bbox.top + bbox.height);
    }
    ctx.restore();
  }

  _line(ctx, stroke, dash, x0, y0, x1, y1) {
    ctx.beginPath();
    ctx.strokeStyle = stroke;
    ctx.setLineDash(dash.map((each) => each * devicePixelRatio));
    ctx.moveTo(x0, y0);
    ctx.lineTo(x1, y1);
    ctx.stroke();
  }

  _picked(u) {
    if (this.onPick && u.cursor.left >= 0) this.onPick(u.posToVal(u.cursor.left, "x"));
  }
}
