// The page: what is shown is the drive at one time. Live, that time follows the latest tick until somebody picks another.

import { $, el, onChange, say } from "./dom.js";
import { Drive } from "./drive.js";
import { Matrix } from "./matrix.js";
import { Memory } from "./memory.js";
import { Signals } from "./signals.js";
import { Test } from "./test.js";
import { candidate, clock, codes, condition, separation, sizes, verdict } from "./words.js";

const STALE_MS = 3000; // without a tick: what is shown is not what is
const STATE_MS = 2000;
const FIRST = 100; // records of a live service that are shown at first
const MOST = 3000; // ticks of a recording at once

/** The JSON at a path; the reason of the problem document where it is refused. */
async function ask(path, options) {
  const answer = await fetch(path, options);
  if (answer.status === 204) return null;
  const body = await answer.json().catch(() => ({ detail: `${answer.status} ${answer.statusText}` }));
  if (!answer.ok) throw new Error(body.detail ?? body.title);
  return body;
}

class Page {
  constructor(system, history) {
    Object.assign(this, { system, history, following: true, row: 0, latest: 0, service: "", broken: new Set(), drawing: false });
    const pick = (t_s) => this.pick(t_s);
    for (const id of ["signal-charts", "test-charts"]) $(id).replaceChildren();
    this.drive = new Drive(system);
    this.signals = new Signals($("signal-charts"), system, pick);
    this.test = new Test($("test-charts"), system, pick);
    this.matrix = new Matrix(system, (test) => { this.chosen = true; this.test.choose(test); this.draw(); });
    this.memory = new Memory(system, ask, !history, history ? pick : null);
    this.explain = onChange((diagnoses, separating) => this._explain(diagnoses, separating));
    $("follow").hidden = Boolean(history);
    $("follow").onclick = () => { this.following = !this.following; this.draw(); };
    $("at").oninput = () => { this._hold(Number($("at").value)); this.draw(); };
    $("window").onchange = () => (history ? this.load(this.drive.t_s[this.row]) : this.draw());
  }

  async begin() {
    await this.state();
    if (this.cursor === undefined) throw new Error(this.detail);
    if (this.history) {
      $("window").value = "0";
      await this.load(Infinity);
      await this.memory.earlier();
    } else {
      this._listen();
    }
    setInterval(() => this.state(), STATE_MS);
    await this.memory.refresh();
  }

  /** Shows the tick at or before a time; of a recording, a part that has it. */
  async pick(t_s) {
    const within = this.drive.length && t_s >= this.drive.t_s[0] && t_s <= this.drive.t_s.at(-1);
    if (this.history && !within) await this.load(t_s);
    this._hold(this.drive.rowAt(t_s));
    this.draw();
  }

  /** Of a recording: the ticks around a time, or all of them. */
  async load(t_s) {
    const seconds = Number($("window").value), part = new URLSearchParams({ count: MOST });
    if (seconds) {
      const begin = Math.max(0, t_s - seconds / 2);
      part.set("after", Math.round(begin / this.system.period_s));
      part.set("before", Math.round((begin + seconds) / this.system.period_s) + 1);
    }
    this.drive.load(await ask(`${this.history}?${part}`));
    this._hold(this.drive.rowAt(t_s));
    this.draw();
  }

  /** How the service is; what it cannot see is said, and that it does not answer. */
  async state() {
    try {
      const body = await ask("/v1/state");
      this.service = body.status;
      this.detail = body.detail;
      this.cursor = body.cursor ?? this.cursor;
      say($("source"), `${this.history ? "recording " : ""}${body.source ?? ""}`);
      this._conditions(body.conditions ?? []);
      if (this.memory.missed) this.memory.refresh();
    } catch (error) {
      this.service = "away";
      this.detail = error.message;
    }
    this.draw();
  }

  /** The verdict at once, as a hidden page has a title too; charts when the browser draws. */
  draw() {
    this._say();
    if (this.drawing) return;
    this.drawing = true;
    requestAnimationFrame(() => { this.drawing = false; this._draw(); });
  }

  /** This row is shown until another is picked. */
  _hold(row) {
    this.following = false;
    this.tick = this.drive.tick[row];
  }

  _listen() {
    this._stream(() => `/v1/live/${encodeURIComponent(this.system.name)}`, {
      live: (tick) => {
        if (tick.bundle !== this.system.bundle) location.reload();  // its names and thresholds are others
        this.latest = performance.now();
        this.drive.push(tick);
        this.draw();
      },
    });
    const take = (record) => {
      this.memory.take([record]);
      if (record.schema !== "faultline.event/1") this.memory.refresh();
    };
    const kinds = Object.fromEntries(["event", "fault", "health", "cleared"].map((kind) => [kind, take]));
    this._stream(() => `/v1/events?after=${this.memory.last ?? Math.max(0, this.cursor - FIRST)}`, kinds);
  }

  /** A stream that is opened again by us where the browser gives it up, as it does when it is refused once. */
  _stream(path, handlers) {
    const source = new EventSource(path());
    for (const [kind, take] of Object.entries(handlers)) source.addEventListener(kind, ({ data }) => take(JSON.parse(data)));
    source.onopen = () => this.broken.delete(source);
    source.onerror = () => {
      this.broken.add(source);
      if (source.readyState !== EventSource.CLOSED) return;
      this.broken.delete(source);
      setTimeout(() => this._stream(path, handlers), STATE_MS);
    };
  }

  /** What is shown: which row, whether it is of now, and its verdict. */
  _say() {
    const stale = !this.history && performance.now() - this.latest > STALE_MS;
    const away = this.service === "away" || stale;
    const kind = away || this.broken.size ? "away" : "there";
    $("connection").dataset.kind = kind;
    say($("connection"), this.service === "away" ? "the service does not answer" : this.history ? "finished recording" : stale ? "no live values" : kind === "away" ? "live, history is behind" : "live");
    document.body.classList.toggle("stale", away && this.following);
    $("follow").setAttribute("aria-pressed", String(this.following));
    this.row = this.following ? Math.max(0, this.drive.length - 1) : this.drive.rowOf(this.tick);
    if (!this.drive.length) {
      this._verdict({ kind: "cannot-tell", text: "Not known: no values yet", more: this.detail ?? "" });
      return;
    }
    const shown = verdict(this.system, this.drive.stands[this.row]), last = verdict(this.system, this.drive.stands.at(-1));
    const when = clock(this.drive.t_s[this.row]);
    if (this.history) {
      const found = this.drive.confirmed();
      const kind = found.length && shown.kind === "well" ? "past" : shown.kind;
      const told = found.length ? `Confirmed in what is shown of this drive: ${found.map((each) => candidate(this.system, each)).join("; ")}.` : "";
      this._verdict({ kind, text: `At ${when}: ${shown.text}`, more: [shown.more, told].filter(Boolean).join(" ") });
    } else if (away) {
      this._verdict({ kind: "cannot-tell", text: "Not known now: nothing comes", more: `${this.detail}. What stood last: ${last.text}.` });
    } else if (this.following) {
      this._verdict(last);
    } else {
      this._verdict({ kind: last.kind === "well" ? "past" : last.kind, text: `Now: ${last.text}`, more: `At ${when}, which is shown: ${shown.text}.` });
    }
  }

  _draw() {
    if (!this.drive.length) return;
    const stand = this.drive.stands[this.row];
    this.explain(stand.diagnoses, stand.separating);
    this._time();
    const [alarming] = stand.alarm;
    if (!this.chosen && alarming && !stand.alarm.includes(this.test.test)) this.test.choose(alarming);
    const [from, to] = this._span();
    this.matrix.show(this.drive, this.row, this.test.test);
    this.signals.show(this.drive, from, to, this.row, this.test.test);
    this.test.show(this.drive, from, to, this.row);
  }

  /** The rows that charts show: of a live service those of the window that ends with the row, or with the latest. */
  _span() {
    const seconds = Number($("window").value);
    if (this.history || !seconds) return [0, this.drive.length];
    const last = this.drive.t_s.at(-1), end = Math.min(last, Math.max(this.drive.t_s[this.row], last - seconds) + (this.following ? 0 : seconds / 2));
    return [this.drive.rowAt(end - seconds), this.drive.rowAt(end) + 1];
  }

  _time() {
    const text = `${clock(this.drive.t_s[this.row])} into the drive, ${this.drive.mode[this.row]}`;
    $("at").max = String(this.drive.length - 1);
    $("at").value = String(this.row);
    $("at").setAttribute("aria-valuetext", text);
    say($("at-text"), text);
  }

  _verdict({ kind, text, more }) {
    $("verdict").dataset.kind = kind;
    say($("verdict-text"), text);
    say($("verdict-more"), more);
    document.title = `${text} – faultline`;
  }

  _conditions(conditions) {
    const lines = conditions.map(condition);
    if (lines.join("\n") !== [...$("conditions").children].map((each) => each.textContent).join("\n")) {
      $("conditions").replaceChildren(...lines.map((text) => el("li", {}, text)));
    }
  }

  _explain(diagnoses, separating) {
    const items = diagnoses.map((each) => {
      const p = each.p === null ? "no probability yet" : `p = ${each.p.toFixed(3)}`;
      const bar = each.p === null ? null : el("span", { class: "p", "aria-hidden": "true" }, el("span", { dataset: { p: each.p } }));
      if (bar) bar.firstChild.style.width = `${100 * each.p}%`;
      return el("li", { value: each.rank }, el("b", {}, candidate(this.system, each)), ` ${[sizes(each), p, codes(this.system, each)].filter(Boolean).join(", ")}`, bar);
    });
    $("diagnoses").replaceChildren(...(items.length ? items : [el("p", {}, "Nothing is confirmed that needs one.")]));
    const lines = separating.map((each) => el("p", {}, separation(this.system, each)));
    $("separating").replaceChildren(...(lines.length ? [el("h3", {}, "What would tell them apart"), ...lines] : []));
  }
}

async function start() {
  const { status, detail, systems } = await ask("/v1/state");
  if (!systems.length) throw new Error(status === "away" ? detail : "no system is watched now");
  const asked = new URLSearchParams(location.search).get("system");
  const { name } = systems.find((each) => each.name === asked) ?? systems[0];
  $("system").replaceChildren(...systems.map((each) => el("option", { value: each.name, selected: each.name === name }, each.name)));
  $("systems").hidden = systems.length < 2;
  $("system").onchange = () => { location.search = new URLSearchParams({ system: $("system").value }); };
  const known = await ask(`/v1/components/${encodeURIComponent(name)}`);
  return new Page(await ask(known.system), known.history);
}

async function begin() {
  for (;;) {
    try {
      return await (await start()).begin();
    } catch (error) {
      $("connection").dataset.kind = "away";
      say($("connection"), "the service does not answer");
      say($("verdict-text"), "Not known: no values yet");
      say($("verdict-more"), error.message);
      await new Promise((resolve) => setTimeout(resolve, STATE_MS));
    }
  }
}

begin();
