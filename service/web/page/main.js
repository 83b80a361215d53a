// The page: what is shown is the drive at one time. Live, that time follows the latest tick until somebody picks another.

import { $, el, onChange, say } from "./dom.js";
import { Drive } from "./drive.js";
import { Matrix } from "./matrix.js";
import { Memory } from "./memory.js";
import { Signals } from "./signals.js";
import { Test } from "./test.js";
import { candidate, clock, codes, condition, separation, verdict } from "./words.js";

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
    Object.assign(this, { system, history, following: !history, latest: 0, service: "", drawing: false });
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
    $("at").oninput = () => { this.following = false; this.row = Number($("at").value); this.draw(); };
    $("window").onchange = () => (history ? this.load(true) : this.draw());
  }

  async begin() {
    await this.state();
    setInterval(() => this.state(), STATE_MS);
    if (this.history) {
      $("window").value = "0";
      await this.load(false);
      await this.memory.earlier();
    } else {
      this._listen();
    }
    await this.memory.refresh();
  }

  /** Shows the tick at or before a time. */
  pick(t_s) {
    this.following = false;
    this.row = this.drive.rowAt(t_s);
    this.draw();
  }

  /** Of a recording: the ticks around the time that is shown, or all of them. */
  async load(around) {
    const t_s = this.drive.length ? this.drive.t_s[this.row] : 0, seconds = Number($("window").value);
    const part = new URLSearchParams({ count: MOST });
    if (seconds) {
      const middle = around ? t_s : 0, ticks = (t) => Math.max(0, Math.round(t / this.system.period_s));
      part.set("after", ticks(middle - seconds / 2));
      part.set("before", ticks(middle - seconds / 2 + seconds) + 1);
    }
    this.drive.load(await ask(`${this.history}?${part}`));
    this.row = around ? this.drive.rowAt(t_s) : this.drive.length - 1;
    this.draw();
  }

  /** How the service is; what it cannot see is said, and that it does not answer. */
  async state() {
    try {
      const body = await ask("/v1/state");
      this.service = body.status;
      this.detail = body.detail;
      this.cursor = body.cursor ?? 0;
      say($("source"), `${this.history ? "recording " : ""}${body.source ?? ""}`);
      this._conditions(body.conditions ?? []);
    } catch (error) {
      this.service = "away";
      this.detail = error.message;
    }
    this.draw();
  }

  draw() {
    if (this.drawing) return;
    this.drawing = true;
    requestAnimationFrame(() => { this.drawing = false; this._draw(); });
  }

  _listen() {
    const ticks = new EventSource(`/v1/live/${encodeURIComponent(this.system.name)}`);
    ticks.addEventListener("live", ({ data }) => {
      this.latest = performance.now();
      this.drive.push(JSON.parse(data));
      this.draw();
    });
    const told = new EventSource(`/v1/events?after=${Math.max(0, this.cursor - FIRST)}`);
    for (const kind of ["event", "fault", "health", "cleared"]) {
      told.addEventListener(kind, ({ data }) => {
        this.memory.take([JSON.parse(data)]);
        if (kind === "fault" || kind === "cleared") this.memory.refresh();
      });
    }
  }

  _draw() {
    const stale = !this.history && performance.now() - this.latest > STALE_MS;
    const away = this.service === "away" || stale;
    $("connection").dataset.kind = away ? "away" : "there";
    say($("connection"), this.service === "away" ? "the service does not answer" : this.history ? "finished recording" : stale ? "no live values" : "live");
    document.body.classList.toggle("stale", away);
    if (this.following) this.row = this.drive.length - 1;
    this.row = Math.max(0, Math.min(this.row ?? 0, this.drive.length - 1));
    $("follow").setAttribute("aria-pressed", String(this.following));
    if (!this.drive.length) {
      this._verdict({ kind: "cannot-tell", text: "Not known: no values yet", more: this.detail ?? "" });
      return;
    }
    const stand = this.drive.stands[this.row];
    this._verdict(away && this.following
      ? { kind: "cannot-tell", text: "Not known now: nothing comes", more: `${this.detail}. What stood last: ${verdict(this.system, stand).text}.` }
      : verdict(this.system, stand));
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
      return el("li", { value: each.rank }, el("b", {}, candidate(this.system, each)), ` ${[p, codes(this.system, each)].filter(Boolean).join(", ")}`, bar);
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
