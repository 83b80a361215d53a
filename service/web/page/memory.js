// What is remembered: faults with their freeze frames, and the list of what was told.

import { Chart } from "./chart.js";
import { $, el } from "./dom.js";
import { clock, record, shown, signalName, wallClock, withUnit } from "./words.js";

const PAGE = 100;

export class Memory {
  /** `ask(path, options)` fetches; `onPick(t_s)` shows a time, null where records are of other drives. */
  constructor(system, ask, canErase, onPick) {
    Object.assign(this, { system, ask, canErase, onPick });
    this.shown = null;
    this.seqs = new Set();
    $("records").replaceChildren();
    $("earlier").onclick = () => this.earlier();
  }

  /** The faults, asked for anew; those that are open stay so. Where the service is away, they are asked for later. */
  async refresh() {
    const path = `/v1/components/${encodeURIComponent(this.system.name)}/faults`;
    const items = await this.ask(path).then((answer) => answer.items, () => null);
    if (items === null) return;
    const key = JSON.stringify(items);
    if (key === this.shown) return;
    this.shown = key;
    const open = new Set([...$("faults").querySelectorAll("details[open]")].map((each) => each.dataset.code));
    $("faults").replaceChildren(...(items.length ? items.map((item) => this._fault(path, item, open.has(item.code))) : [el("p", {}, "No fault is remembered.")]));
  }

  /** Takes records, in any order and any twice; the latest are on top. */
  take(records) {
    for (const each of records) {
      if (this.seqs.has(each.seq)) continue;
      this.seqs.add(each.seq);
      const before = [...$("records").children].find((line) => Number(line.dataset.seq) < each.seq);
      $("records").insertBefore(this._record(each), before ?? null);
    }
    $("earlier").hidden = !this.seqs.size || Math.min(...this.seqs) <= 1;
  }

  async earlier() {
    const before = this.seqs.size ? `&before=${Math.min(...this.seqs)}` : "";
    try {
      const { records } = await this.ask(`/v1/records?count=${PAGE}${before}`);
      this.take(records);
      if (records.length < PAGE) $("earlier").hidden = true;
    } catch (error) {
      $("earlier").replaceWith(el("p", {}, `Nothing earlier: ${error.message}.`));
    }
  }

  _record(one) {
    const when = wallClock(one.wall);
    const goes = this.onPick && one.t_s !== undefined;
    const time = goes ? el("button", { type: "button", onclick: () => this.onPick(one.t_s) }, clock(one.t_s)) : el("time", {}, when || `no. ${one.seq}`);
    return el("li", { dataset: { seq: one.seq } }, time, record(this.system, one));
  }

  _fault(path, item, open) {
    const status = item.status;
    const tags = [
      el("span", { class: `tag ${status.aggregatedStatus}` }, status.aggregatedStatus),
      el("span", { class: "tag" }, status.confirmedDTC === "1" ? "confirmed" : "pending"),
      status.warningIndicatorRequested === "1" ? el("span", { class: "tag" }, "warned of") : null,
    ];
    const body = el("div", {});
    const made = el("details", { dataset: { code: item.code } }, el("summary", {}, el("b", {}, `${item.code}. ${item.fault_name}`), ...tags), body);
    made.addEventListener("toggle", async () => {
      if (!made.open) return;
      try {
        body.replaceChildren(...this._detail(path, item, await this.ask(`${path}/${item.code}`)));
      } catch (error) {
        body.replaceChildren(el("p", {}, error.message));
      }
    });
    if (open) made.open = true;
    return made;
  }

  _detail(path, item, { environment_data: known }) {
    const more = known.extended_data_records;
    const seen = (which) => wallClock(more[which].wall) || more[which].id;
    const facts = [
      `code ${item.display_code || "none"}, status ${item.status.mask}`,
      `${item.symptom}`,
      `seen ${more.occurrences}×, first ${seen("first")}, last ${seen("latest")}`,
    ];
    const frames = known.snapshots.filter((each) => each.data).flatMap((each) => this._frame(each.record, each.data));
    return [el("ul", {}, ...facts.map((text) => el("li", {}, text))), ...frames, ...(this.canErase ? [this._eraser(path, item)] : [])];
  }

  _frame(which, frame) {
    const title = `Freeze frame, ${which === "first" ? "when it was told first" : "the latest time"}`;
    const where = `${wallClock(frame.wall) || frame.event}, ${clock(frame.t_s)} into the drive, mode ${frame.mode}${frame.complete ? "" : "; the service was stopped before its end"}`;
    const inputs = table(["signal", "last good value", "quality", "age"], frame.inputs.map((each) => [signalName(each.signal), withUnit(each.value, each.unit), each.quality, each.age_s === null ? "never" : `${each.age_s.toFixed(1)} s`]));
    const tests = table(["test", "verdict", "residual", "CUSUM"], frame.tests.map((each) => [each.generator, each.verdict, withUnit(each.residual, this._unit(each.predicts)), each.sum.toFixed(2)]));
    const host = el("div", {});
    this._excerpt(host, frame);
    const conditions = frame.conditions.length ? [el("p", {}, `Standing then: ${frame.conditions.join("; ")}`)] : [];
    return [el("h3", {}, title), el("p", { class: "soft" }, where), host, ...conditions, wide(inputs), wide(tests)];
  }

  /** What the first test that fired predicts, measured and predicted around that time. */
  _excerpt(host, frame) {
    const test = frame.tests.find((each) => each.verdict === "alarm") ?? frame.tests[0];
    if (!test) return;
    const { first_tick: first, period_s: period, signals, residuals, sums } = frame.excerpt;
    const { unit, factor } = shown(this._unit(test.predicts));
    const t = signals[test.predicts].map((_, k) => (first + k) * period);
    const measured = signals[test.predicts].map((value) => (value === null ? null : value * factor));
    const predicted = measured.map((value, k) => (value === null || residuals[test.generator][k] === null ? null : value - residuals[test.generator][k] * factor));
    const name = signalName(test.predicts);
    requestAnimationFrame(() => {  // once it has a width
      new Chart(host, { title: name, unit, series: [{ colour: "predicted", dash: [6, 4] }, { colour: "measured" }] })
        .set([t, predicted, measured], frame.t_s, [el("span", { class: "measured" }, "measured"), el("span", { class: "predicted" }, `predicted by ${test.generator}`)], `${name} around the time of the freeze frame, measured, and as ${test.generator} predicts it`);
      new Chart(host, { title: `CUSUM of ${test.generator}`, unit: "parts of the threshold", series: [{ colour: "measured" }], limits: [-1, 1] })
        .set([t, sums[test.generator]], frame.t_s, [], `CUSUM of ${test.generator} around that time`);
    });
  }

  _unit(signal) {
    return this.system.inputs.find((each) => each.signal === signal)?.unit ?? "";
  }

  _eraser(path, item) {
    const token = el("input", { type: "password", autocomplete: "off", "aria-label": "token", placeholder: "token", required: true });
    const said = el("output", {});
    const erase = async (event) => {
      event.preventDefault();
      try {
        await this.ask(`${path}/${item.code}`, { method: "DELETE", headers: { Authorization: `Bearer ${token.value}` } });
        await this.refresh();
      } catch (error) {
        said.textContent = error.message;
      }
    };
    return el("form", { onsubmit: erase }, token, el("button", { type: "submit" }, `Erase fault ${item.code}`), said);
  }
}

function table(heads, rows) {
  return el("table", {}, el("thead", {}, el("tr", {}, ...heads.map((text) => el("th", { scope: "col" }, text)))),
    el("tbody", {}, ...rows.map(([first, ...others]) => el("tr", {}, el("th", { scope: "row" }, first), ...others.map((text) => el("td", {}, text))))));
}

const wide = (inside) => el("div", { class: "wide" }, inside);
