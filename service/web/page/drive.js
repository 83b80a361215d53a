// The ticks that the page knows, as columns by name: of a live service the latest ones, of a recording a part of it.

const KEPT = 6000; // ticks of a live service: 20 minutes at 5 a second
const SLACK = 500;

export class Drive {
  constructor(system) {
    this.system = system;
    this.signals = system.inputs.map((each) => each.signal);
    this.generators = system.generators.map((each) => each.name);
    this.clear();
  }

  clear() {
    const named = (names) => Object.fromEntries(names.map((name) => [name, []]));
    this.tick = [];
    this.t_s = [];
    this.mode = [];
    this.stands = [];
    this.z = named(this.signals);
    this.quality = named(this.signals);
    for (const each of ["y_hat", "r", "sigma", "sums"]) this[each] = named(this.generators);
  }

  get length() {
    return this.tick.length;
  }

  /** Takes a tick of the live stream; one that is earlier belongs to a service that has begun anew. */
  push(tick) {
    if (tick.tick === this.tick.at(-1)) return;
    if (tick.tick < this.tick.at(-1)) this.clear();
    this.tick.push(tick.tick);
    this.t_s.push(tick.t_s);
    this.mode.push(tick.mode);
    const { alarm, cannot_tell, anomaly, diagnoses, separating } = tick;
    this.stands.push({ alarm, cannot_tell, anomaly, diagnoses, separating });
    this.signals.forEach((name, k) => {
      this.z[name].push(tick.quality[k] === "good" ? tick.z[k] : null);
      this.quality[name].push(tick.quality[k]);
    });
    this.generators.forEach((name, k) => {
      for (const each of ["y_hat", "r", "sigma"]) this[each][name].push(tick.usable[k] ? tick[each][k] : null);
      this.sums[name].push(tick.sums[k]);
    });
    if (this.length > KEPT + SLACK) this._trim(this.length - KEPT);
  }

  /** Takes a part of a recording, instead of what was there. */
  load(part) {
    Object.assign(this, { tick: part.tick, t_s: part.t_s, mode: part.mode });
    for (const each of ["z", "quality", "y_hat", "r", "sigma", "sums"]) this[each] = part[each];
    let k = 0;
    this.stands = this.tick.map((tick) => {
      while (k + 1 < part.stands.length && part.stands[k + 1].tick <= tick) k += 1;
      return part.stands[k];
    });
  }

  /** The last row at or before a time [s]; 0 where there is none. */
  rowAt(t_s) {
    return lastAtMost(this.t_s, t_s);
  }

  /** The last row at or before a tick; 0 where there is none. */
  rowOf(tick) {
    return lastAtMost(this.tick, tick);
  }

  /** The first explanations that stood at any time, each once. */
  confirmed() {
    const best = this.stands.flatMap((stand) => stand.diagnoses.filter((each) => each.rank === 1));
    return [...new Map(best.map((each) => [each.faults.join(), each])).values()];
  }

  /** What a test lets pass of its residual in each row: [low, high], in the unit of what it predicts. */
  band(generator, from, to) {
    const detector = this.system.detectors[this.generators.indexOf(generator)];
    const width = detector.kind === "cusum" ? detector.nu : detector.J;
    const low = [], high = [];
    for (let k = from; k < to; k += 1) {
      const mode = this.system.modes.indexOf(this.mode[k]);
      const can = this.r[generator][k] !== null;
      low.push(can ? detector.offset[mode] - width * detector.scale[mode] : null);
      high.push(can ? detector.offset[mode] + width * detector.scale[mode] : null);
    }
    return [low, high];
  }

  _trim(count) {
    const columns = [this.tick, this.t_s, this.mode, this.stands];
    for (const each of ["z", "quality", "y_hat", "r", "sigma", "sums"]) columns.push(...Object.values(this[each]));
    for (const column of columns) column.splice(0, count);
  }
}

function lastAtMost(values, wanted) {
  let low = 0, high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= wanted) low = middle + 1;
    else high = middle;
  }
  return Math.max(0, low - 1);
}

/** The verdict of a test in what stands. */
export function verdictOf(stand, test) {
  if (stand.cannot_tell.includes(test)) return "cannot tell";
  return stand.alarm.includes(test) ? "alarm" : "quiet";
}
