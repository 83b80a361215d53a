// Measured signals beside what a test predicts of them and the band that it lets pass; the others as they are.

import { Chart } from "./chart.js";
import { el } from "./dom.js";
import { shown, signalName, withUnit } from "./words.js";

export class Signals {
  /** Fills `host`; `onPick(t_s)` is called where a chart is clicked. */
  constructor(host, system, onPick) {
    this.system = system;
    this.charts = system.inputs.map(({ signal }) => {
      const can = system.generators.filter((each) => each.predicts === signal).map((each) => each.name);
      const series = [{ label: "measured", colour: "measured", width: 2 }];
      if (can.length) {
        series.unshift({ label: "high", width: 0 }, { label: "low", width: 0 }, { label: "predicted", colour: "predicted", dash: [6, 4], width: 2 });
      }
      const name = signalName(system, signal), as = shown(system, signal);
      const chart = new Chart(host, { title: name, unit: as.unit, series, band: can.length ? [1, 2] : undefined, onPick });
      return { signal, name, as, can, by: can[0], chart };
    });
  }

  /** Shows rows `from` to `to` of the drive, and `row` in words; `test` is the one whose predictions are wanted. */
  show(drive, from, to, row, test) {
    const t = drive.t_s.slice(from, to), at = drive.t_s[row];
    for (const each of this.charts) {
      const { as } = each;
      const scaled = (values) => values.map(as.value);
      const measured = drive.z[each.signal];
      const good = drive.quality[each.signal][row] === "good";
      const words = [`measured ${good ? withUnit(as.value(measured[row]), as) : drive.quality[each.signal][row]}`];
      const data = [t, scaled(measured.slice(from, to))];
      each.by = each.can.find((name) => name.startsWith(`${test}.`)) ?? each.by;
      if (each.by) {
        const [low, high] = drive.band(each.by, from, to), predicted = drive.y_hat[each.by].slice(from, to);
        const around = (edge) => predicted.map((value, k) => (value === null || edge[k] === null ? null : as.value(value + edge[k])));
        data.splice(1, 0, around(high), around(low), scaled(predicted));
        const now = drive.y_hat[each.by][row];
        words.push(`predicted ${now === null ? "nothing: it cannot tell" : withUnit(as.value(now), as)} by ${each.by}`);
      }
      const spans = words.map((text, k) => el("span", { class: ["measured", "predicted"][k] }, text));
      each.chart.set(data, at, spans, `${each.name}: ${words.join(", ")}`);
    }
  }
}
