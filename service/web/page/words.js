// How things read: units, names, verdicts. Pure.

const CHANGES = {
  pending: "is pending", confirmed: "is confirmed", failed: "is there again", refined: "has other candidates",
  withdrawn: "was not it", revoked: "is erased: it was another one, or rested on samples that are doubted", passed: "is not there any more", settled: "was not there for a cycle", aged: "is forgotten",
  displaced: "is forgotten, for want of room",
};
const TRANSITIONS = {
  started: "started", suspected: "suspected", dismissed: "suspicion dismissed", occurred: "fault confirmed",
  refined: "explanations changed", healed: "healed", cannot_tell: "other tests cannot tell",
  withdrawn: "withdrawn: it rested on samples that are doubted",
};

const input = (system, signal) => system.inputs.find((each) => each.signal === signal);

/** A signal by its label, as the bundle has it, or by its name. */
export function signalName(system, signal) {
  const label = input(system, signal)?.label;
  return label ? label[0].toUpperCase() + label.slice(1) : signal;
}

/** The unit that people read a signal in, and what a value and a residual of the bundle's unit are in it. */
export function shown(system, signal) {
  const known = input(system, signal);
  const { unit, size = 1, zero = 0, digits = null } = known?.display?.[0] ?? { unit: known?.unit ?? "" };
  const of = (none) => (value) => (value === null || value === undefined ? null : (value - none) / size);
  return { unit, digits, value: of(zero), residual: of(0) };
}

/** A number in the unit of `as`, as `shown` gives it. */
export function withUnit(number, as) {
  if (number === null) return "no value";
  const text = as.digits === null ? String(Number(number.toPrecision(6))) : number.toFixed(as.digits);
  return `${text} ${as.unit === "1" ? "" : as.unit}`.trimEnd();
}

/** A duration since the log's first tick. */
export function clock(t_s) {
  const minutes = Math.floor(t_s / 60);
  return `${minutes}:${(t_s - 60 * minutes).toFixed(1).padStart(4, "0")}`;
}

export function wallClock(wall) {
  return wall ? wall.replace("T", " ").replace(/\.\d+/, "").replace("+00:00", " UTC").replace("Z", " UTC") : "";
}

/** What a set of fault names means, by the system's description. */
export function candidate(system, diagnosis) {
  if (diagnosis.faults.length === 0) {
    const near = diagnosis.near.map((name) => equation(system, name)).join(", ");
    return `Unknown: no component's fault that is known${near ? `, near ${near}` : ""}`;
  }
  return diagnosis.faults.map((name) => fault(system, name)).join(" and ");
}

/** How large it is, what is lost as a loss. */
export function sizes(diagnosis) {
  return diagnosis.sizes.map(({ low, high, unit, of }) => {
    if (of && high <= 0) return `${-high} to ${-low} ${unit} of the ${of} lost`;
    return `by ${low} to ${high} ${unit}${of && ` of the ${of}`}`;
  }).join(", ");
}

export function fault(system, name) {
  const known = system.faults.find((each) => each.name === name);
  return known ? [`${known.component}${known.place ? ` (${known.place})` : ""}`, known.description].filter(Boolean).join(": ") : name;
}

export function component(system, name) {
  return system.faults.find((each) => each.name === name)?.component ?? name;
}

export function codes(system, diagnosis) {
  return diagnosis.faults.flatMap((name) => {
    const known = system.faults.find((each) => each.name === name);
    return known?.spn ? [`SPN ${known.spn} FMI ${known.fmi}`] : [];
  }).join(", ");
}

function equation(system, name) {
  const doubt = system.disturbances.filter((each) => each.equation === name).map((each) => `${each.description}?`);
  const known = system.equations.find((each) => each.name === name);
  return known ? `${name} (${[known.description, ...doubt].join(": ")})` : name;
}

/** The verdict of what stands: its kind, what it says, and what is to be said besides. Silence is never "no fault". */
export function verdict(system, stand) {
  const alarms = stand.alarm.length ? `Alarming: ${stand.alarm.join(", ")}.` : "";
  const blind = stand.cannot_tell.length ? `Cannot tell: ${stand.cannot_tell.join(", ")}.` : "";
  if (stand.diagnoses.length) {
    const best = stand.diagnoses.filter((each) => each.rank === 1).map((each) => candidate(system, each));
    return { kind: "fault", text: `Fault: ${best.join(", or ")}`, more: `${alarms} ${blind}`.trim() };
  }
  if (stand.alarm.length || stand.anomaly) {
    const why = alarms || "No test alarms by itself, but the residuals together have changed.";
    return { kind: "suspected", text: "Something is suspected, and not confirmed yet", more: `${why} ${blind}`.trim() };
  }
  if (stand.cannot_tell.length) {
    return { kind: "cannot-tell", text: "No alarm, but not known to be free of faults", more: blind };
  }
  return { kind: "well", text: "No fault: every test is quiet", more: "" };
}

/** A pair of explanations and what would tell them apart. */
export function separation(system, one) {
  const [a, b] = one.between.map((names) => names.map((name) => component(system, name)).join(" and "));
  const pair = `${a} or ${b}`;
  if (!one.telling.length && !one.waiting.length) {
    const modes = system.modes.filter((mode) => mode !== "edge").join(", ");
    return `${pair}: no test is sensitive to one of them alone. Size and sign of the residuals tell: operate it in each mode (${modes}).`;
  }
  const now = one.telling.length ? `${one.telling.join(", ")}, which can tell now` : "";
  const later = one.waiting.length ? `${one.waiting.join(", ")}, which cannot tell now` : "";
  return `${pair}: sensitive to one of them alone are ${[now, later].filter(Boolean).join("; ")}.`;
}

/** A record of the stream for a person: when, and what. */
export function record(system, one) {
  switch (one.schema) {
    case "faultline.event/1": {
      const best = one.diagnoses.filter((each) => each.rank === 1).map((each) => candidate(system, each)).join(", or ");
      const what = best || (one.alarm.length ? `alarming: ${one.alarm.join(", ")}` : "");
      const blind = one.cannot_tell.length ? `cannot tell: ${one.cannot_tell.join(", ")}` : "";
      const clear = one.transition === "cannot_tell" && !one.cannot_tell.length;
      return [clear ? "all tests can tell" : TRANSITIONS[one.transition] ?? one.transition, what, blind].filter(Boolean).join("; ");
    }
    case "faultline.fault/1": {
      const names = one.fault.diagnoses.map((each) => candidate(system, each)).join(", or ");
      return `fault ${one.fault.number} ${CHANGES[one.change] ?? one.change}: ${names}`;
    }
    case "faultline.health/1":
      return one.conditions.length ? `buses and signals: ${one.conditions.map(condition).join("; ")}` : "all is well with buses and signals";
    case "faultline.cleared/1":
      return `erased by ${one.by}: ${one.numbers.join(", ") || "nothing"}`;
    default:
      return `${one.schema}: not known to this page`;
  }
}

export function condition(one) {
  return `${one.of}: ${one.kind.replaceAll("-", " ")}${one.since ? `, since ${wallClock(one.since)}` : ""}`;
}
