// One test: its residual with what it lets pass, and its CUSUM against the threshold.

import { Chart } from "./chart.js";
import { $, el, say } from "./dom.js";
import { verdictOf } from "./drive.js";
import { component, shown, signalName, withUnit } from "./words.js";

export class Test {
  constructor(host, system, onPick) {
    Object.assign(this, { host, system, onPick });
    this.charts = [];
    this.choose(system.generators[0].test);
  }

  /** Shows this test from now on: two charts for each of its generators, the equations' and the network's. */
  choose(test) {
    this.test = test;
    this.charts.forEach(({ residual, sum }) => [residual, sum].forEach((each) => each.remove()));
    const generators = this.system.generators.filter((each) => each.test === test);
    this.charts = generators.map((generator) => {
      const as = shown(this.system, generator.predicts);
      const name = generators.length > 1 ? ` of ${generator.name}` : "";
      const series = [{ width: 0 }, { width: 0 }, { label: "residual", colour: "measured", width: 2 }];
      return {
        generator, as,
        residual: new Chart(this.host, { title: `Residual${name}`, unit: as.unit, series, band: [1, 2], onPick: this.onPick }),
        sum: new Chart(this.host, { title: `CUSUM${name}`, unit: "parts of the threshold", series: [{ label: "sum", colour: "measured", width: 2 }], limits: [-1, 1], onPick: this.onPick }),
      };
    });
    const { faults, inputs, predicts } = generators[0];
    const names = faults.map((name) => component(this.system, name)).join(", ");
    say($("test-title"), `Residual and CUSUM of ${test}`);
    say($("test-text"), `Predicts “${signalName(this.system, predicts)}” from ${inputs.map((each) => signalName(this.system, each)).join(", ")}. Sensitive to: ${names}.`);
  }

  show(drive, from, to, row) {
    const t = drive.t_s.slice(from, to), at = drive.t_s[row];
    const verdict = verdictOf(drive.stands[row], this.test);
    for (const { generator: { name }, as, residual, sum } of this.charts) {
      const scaled = (values) => values.map(as.residual);
      const [low, high] = drive.band(name, from, to);
      const r = drive.r[name][row], now = drive.sums[name][row];
      const text = r === null ? "cannot tell" : withUnit(as.residual(r), as);
      residual.set([t, scaled(high), scaled(low), scaled(drive.r[name].slice(from, to))], at, [el("span", { class: "measured" }, text)], `Residual of ${name}: ${text}`);
      const parts = `${now === null ? "no value" : now.toFixed(2)}: ${verdict}`;
      sum.set([t, drive.sums[name].slice(from, to)], at, [el("span", {}, parts)], `CUSUM of ${name} in parts of its threshold: ${parts}`);
    }
  }
}
