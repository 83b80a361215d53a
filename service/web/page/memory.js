// What is remembered: faults with their freeze frames, and the list of what was told.

import { Chart } from "./chart.js";
import { $, el } from "./dom.js";
import { clock, record, shown, signalName, wallClock, withUnit } from "./words.js";

const PAGE = 100;
const MOST = 2000; // records in the list

export class Memory {
  /** `ask(path, options)` fetches; `onPick(t_s)` shows a time, null where records are of other drives. */
  constructor(system, ask, canErase, onPick) {
    Object.assign(this, { system, ask, canErase, onPick, last: null, missed: false });
    this.known = new Map(); // by code: what the item was, its element and the charts in it
    this.erasers = new Map(); // by code: a form that is half filled in outlives what is shown anew around it
    this.asking = this.again = false;
    $("records").replaceChildren();
    $("earlier").onclick = () => this.earlier();
  }

  /** The faults, asked for anew, one question at a time; `missed` where they could not be. */
  async refresh() {
    this.again = true;
    if (this.asking) return;
    this.asking = true;
    const path = `/v1/components/${encodeURIComponent(this.system.name)}/faults`;
    while (this.again) {
      this.again = false;
      try {
        this._faults(path, (await this.ask(path)).items);
        this.missed = false;
      } catch (error) {
        this.missed = true;
        if (!this.known.size) $("faults").replaceChildren(el("p", {}, `Not known: ${error.message}`));
      }
    }
    this.asking = false;
  }

  /** Takes records, in any order and any twice; the latest are on top. */
  take(records) {
    const lines = $("records").children;
    for (const each of records) {
      let k = 0;
      while (k < lines.length && Number(lines[k].dataset.seq) > each.seq) k += 1;
      if (lines[k]?.dataset.seq === String(each.seq)) continue;
      $("records").insertBefore(this._record(each), lines[k] ?? null);
      this.last = Math.max(this.last ?? 0, each.seq);
    }
    while (lines.length > MOST) lines[lines.length - 1].remove();
    $("earlier").hidden = !lines.length || lines.length >= MOST || this._first() <= 1;
  }

  /** What was told before the first that is shown. */
  async earlier() {
    try {
      const before = $("records").children.length ? `&before=${this._first()}` : "";
      const { records } = await this.ask(`/v1/records?count=${PAGE}${before}`);
      this.take(records);
      if (records.length < PAGE) $("earlier").hidden = true;
    } catch (error) {
      $("earlier").textContent = `Earlier (${error.message})`;
    }
  }

  _first() {
    return Number($("records").lastChild.dataset.seq);
  }

  /** Those that are as they were stay as they are, opened or half filled in. */
  _faults(path, items) {
    const before = this.known;
    this.known = new Map(items.map((item) => {
      const key = JSON.stringify(item), was = before.get(item.code);
      if (was?.key === key) return [item.code, was];
      const charts = [];
      return [item.code, { key, charts, element: this._fault(path, item, Boolean(was?.element.open), charts) }];
    }));
    for (const [code, was] of before) {
      if (this.known.get(code) !== was) was.charts.forEach((chart) => chart.remove());
      if (!this.known.has(code)) this.erasers.delete(code);
    }
    const elements = [...this.known.values()].map((each) => each.element);
    const shown = elements.length ? elements : [el("p", {}, "No fault is remembered.")];
    if (shown.length !== $("faults").children.length || shown.some((each, k) => $("faults").children[k] !== each)) $("faults").replaceChildren(...shown);
  }

  _record(one) {
    const when = wallClock(one.wall);
    const goes = this.onPick && one.t_s !== undefined;
    const time = goes ? el("button", { type: "button", onclick: () => this.onPick(one.t_s) }, clock(one.t_s)) : el("time", {}, when || `no. ${one.seq}`);
    const other = (one.fault && one.fault.system !== this.system.name) || (one.bundle && one.bundle !== this.system.bundle);
    const whose = other ? `${one.fault?.system ?? "another bundle"}: ` : "";
    return el("li", { dataset: { seq: one.seq } }, time, whose + record(this.system, one));
  }

  _fault(path, item, open, charts) {
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
        const known = await this.ask(`${path}/${item.code}`);
        charts.splice(0).forEach((chart) => chart.remove());
        body.replaceChildren(...this._detail(path, item, known, charts));
      } catch (error) {
        body.replaceChildren(el("p", {}, error.message));
      }
    });
    if (open) made.open = true;
    return made;
  }

  _detail(path, item, { environment_data: known }, charts) {
    const more = known.extended_data_records;
    const seen = (which) => wallClock(more[which].wall) || more[which].id;
    const facts = [
      `code ${item.display_code || "none"}, status ${item.status.mask}`,
      `${item.symptom}`,
      `seen ${more.occurrences}×, first ${seen("first")}, last ${seen("latest")}`,
    ];
    const frames = known.snapshots.filter((each) => each.data).flatMap((each) => this._frame(each.record, each.data, charts));
    return [el("ul", {}, ...facts.map((text) => el("li", {}, text))), ...frames, ...(this.canErase ? [this._eraser(path, item)] : [])];
  }

  _frame(which, frame, charts) {
    const title = `Freeze frame, ${which === "first" ? "when it was told first" : "the latest time"}`;
    const where = `${wallClock(frame.wall) || frame.event}, ${clock(frame.t_s)} into the drive, mode ${frame.mode}${frame.complete ? "" : "; the service was stopped before its end"}`;
    const inputs = table(["signal", "last good value", "quality", "age"], frame.inputs.map((each) => [signalName(this.system, each.signal), this._read(each.signal, "value", each.value), each.quality, each.age_s === null ? "never" : `${each.age_s.toFixed(1)} s`]));
    const tests = table(["test", "verdict", "residual", "CUSUM"], frame.tests.map((each) => [each.generator, each.verdict, this._read(each.predicts, "residual", each.residual), each.sum.toFixed(2)]));
    const host = el("div", {});
    this._excerpt(host, frame, charts);
    const conditions = frame.conditions.length ? [el("p", {}, `Standing then: ${frame.conditions.join("; ")}`)] : [];
    return [el("h3", {}, title), el("p", { class: "soft" }, where), host, ...conditions, wide(inputs), wide(tests)];
  }

  /** What the first test that fired predicts, measured and predicted around that time. */
  _excerpt(host, frame, charts) {
    const test = frame.tests.find((each) => each.verdict === "alarm") ?? frame.tests[0];
    if (!test) return;
    const { first_tick: first, period_s: period, signals, residuals, sums } = frame.excerpt;
    const as = shown(this.system, test.predicts);
    const t = signals[test.predicts].map((_, k) => (first + k) * period);
    const measured = signals[test.predicts].map(as.value);
    const predicted = measured.map((value, k) => (value === null || residuals[test.generator][k] === null ? null : value - as.residual(residuals[test.generator][k])));
    const name = signalName(this.system, test.predicts);
    const draw = (options, data, values, text) => {
      const chart = new Chart(host, options);
      charts.push(chart);
      chart.set(data, frame.t_s, values, text);
    };
    requestAnimationFrame(() => {  // once it has a width
      draw({ title: name, unit: as.unit, series: [{ colour: "predicted", dash: [6, 4] }, { colour: "measured" }] }, [t, predicted, measured],
        [el("span", { class: "measured" }, "measured"), el("span", { class: "predicted" }, `predicted by ${test.generator}`)],
        `${name} around the time of the freeze frame, measured, and as ${test.generator} predicts it`);
      draw({ title: `CUSUM of ${test.generator}`, unit: "parts of the threshold", series: [{ colour: "measured" }], limits: [-1, 1] },
        [t, sums[test.generator]], [], `CUSUM of ${test.generator} around that time`);
    });
  }

  /** A `value` or `residual` of a signal as people read it. */
  _read(signal, kind, number) {
    const as = shown(this.system, signal);
    return withUnit(as[kind](number), as);
  }

  _eraser(path, item) {
    if (!this.erasers.has(item.code)) this.erasers.set(item.code, this._form(path, item));
    return this.erasers.get(item.code);
  }

  _form(path, item) {
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
