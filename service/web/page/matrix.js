// The fault signature matrix: a row a test, a column a fault; what alarms and what stands as an explanation is marked.

import { $, el, say } from "./dom.js";
import { verdictOf } from "./drive.js";
import { fault } from "./words.js";

const MARKS = { alarm: "●", quiet: "○", "cannot tell": "?" };

export class Matrix {
  /** Fills the table; `onChoose(test)` is called where a test's button is pressed. */
  constructor(system, onChoose) {
    const tests = [...new Set(system.generators.map((each) => each.test))];
    this.system = system;
    this.heads = system.faults.map((each) => el("th", { scope: "col", class: "fault", title: `${each.name}, ${fault(system, each.name)}` }, el("span", {}, each.component)));
    this.rows = tests.map((test) => this._row(test, onChoose));
    const head = el("tr", {}, ...["test", "verdict", "CUSUM"].map((text) => el("th", { scope: "col" }, text)), ...this.heads);
    $("tests").replaceChildren(
      el("caption", { class: "hidden-text" }, "Tests by the faults that they are sensitive to, with their verdicts"),
      el("thead", {}, head), el("tbody", {}, ...this.rows.map((each) => each.row)),
    );
  }

  show(drive, row, chosen) {
    const stand = drive.stands[row];
    const candidates = new Set(stand.diagnoses.flatMap((each) => each.faults));
    this.heads.forEach((head, k) => head.classList.toggle("candidate", candidates.has(this.system.faults[k].name)));
    for (const each of this.rows) {
      const verdict = verdictOf(stand, each.test);
      const sum = this._largest(drive, each.test, row);
      each.row.dataset.verdict = verdict;
      say(each.verdict, verdict);
      say(each.value, sum === null ? "–" : sum.toFixed(2));
      each.bar.style.width = `${Math.min(100, 50 * Math.abs(sum ?? 0))}%`;
      each.button.setAttribute("aria-pressed", String(each.test === chosen));
      each.cells.forEach(({ cell, mark, name }) => {
        cell.classList.toggle("candidate", candidates.has(name));
        if (mark) say(mark, MARKS[verdict]);
      });
    }
  }

  _row(test, onChoose) {
    const sensitive = new Set(this.system.generators.filter((each) => each.test === test).flatMap((each) => each.faults));
    const button = el("button", { type: "button", onclick: () => onChoose(test) }, test);
    const verdict = el("td", {}), value = el("span", {}), bar = el("span", {});
    const cells = this.system.faults.map(({ name }) => {
      const mark = sensitive.has(name) ? el("span", { "aria-hidden": "true" }) : null;
      const words = el("span", { class: "hidden-text" }, mark ? "sensitive" : "not sensitive");
      return { name, mark, cell: el("td", { class: mark ? "cell sensitive" : "cell" }, mark, words) };
    });
    const sum = el("td", {}, el("span", { class: "sum", "aria-hidden": "true" }, bar), " ", value);
    const row = el("tr", {}, el("th", { scope: "row" }, button), verdict, sum, ...cells.map((each) => each.cell));
    return { test, row, button, verdict, value, bar, cells };
  }

  /** The sum of the test's generator that is furthest, with its sign. */
  _largest(drive, test, row) {
    const sums = this.system.generators.filter((each) => each.test === test).map((each) => drive.sums[each.name][row]);
    return sums.filter((each) => each !== null).reduce((most, each) => (most === null || Math.abs(each) > Math.abs(most) ? each : most), null);
  }
}
