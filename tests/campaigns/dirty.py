"""Samples that are off, in drives with and without a fault: `make campaign-dirty`.

    .venv/bin/python tests/campaigns/dirty.py --vehicles 921 922

Trucks of the rig's fleet (profile `everyday`, hidden effects of set A or B), calibrated and tuned as their workshop
would (`diagnosis_shop`). One fault-free drive and one with each of some faults; then the same frames again, with part
of the samples of one signal off, alone or in bursts of five, by an amplitude that may be physical or not. A line of the
results is a vehicle; what is there of the same code is not made again.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from by_vehicle import Campaign, run, set_of
from diagnosis_cases import Case, Kind, hidden, seed_of
from diagnosis_shop import Workshop, run_of, said
from results_page import exact_share, provenance

from faultline.service.bundle.load import Bundle
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.testbench.bus import load_dbc
from faultline.testbench.traffic import Frame, frames

Record = dict[str, Any]

VEHICLES = tuple(range(921, 925))
SECONDS = 420.0
PART = 0.05
"""This part of the samples of one signal is off."""
BURSTS = (1, 5)
OFF: dict[str, tuple[float, float]] = {
    "y_p_tp": (3.0, 20.0),
    "y_p_ap": (10.0, 100.0),
    "y_p_du": (10.0, 100.0),
    "n_p": (1.5, 10.0),
    "dc_dose": (5.0, 40.0),
}
"""A small and a large amplitude, in the units of the DBC (kPa, 1/s, %): the one within what operation does as well."""
AMPLITUDES = ("small", "large", "anything")
"""Each has either sign; *anything* is any number that the frame can hold, physical or not."""
FAULTS = (("fA_t", 0.6), ("fA_du", 0.55), ("fA_ori", 0.2), ("fq_pump", 0.15), ("fy_p_ap", 4e4))
"""The sizes are those of the ladder's second rung."""
EACH = 3
"""Every third of the ways in which a healthy drive is dirtied is tried with each fault."""
HEAD = """# Dirty samples

All data are **simulated** by the rig. Made by `make campaign-dirty`; vehicles, faults, amplitudes and what counts are
declared in `tests/campaigns/dirty.py`, frozen before it was run. 5 % of the samples of one signal are off, alone or in
bursts of five. *A fault of it*: a diagnosis in a drive without a fault, or before the onset, where the clean drive has
none. *Hidden*: the clean drive's fault is not found, or is not of rank 1 in the end. Intervals of 95 % are exact.
"""
RESULTS = Path("docs/results/dirty.jsonl")
WORK = Path("out/campaign-dirty")
FROZEN = (
    "analysis", "service", "testbench", "dbc", "tests/campaigns/dirty.py", "tests/campaigns/diagnosis_shop.py",
)  # fmt: skip


@dataclass(frozen=True)
class Dirt:
    """Samples of a `signal` that are off by an `amplitude`, `burst` of them at a time."""

    signal: str
    burst: int
    amplitude: str

    def on(self, sent: Sequence[Frame], rng: np.random.Generator) -> Iterator[Frame]:
        """The frames with a part of the signal's samples off."""
        message = next(m for m in MESSAGES if any(s.name == self.signal for s in m.signals))
        signal = message.get_signal_by_name(self.signal)
        assert signal.minimum is not None
        assert signal.maximum is not None
        low, high, left = float(signal.minimum), float(signal.maximum), 0
        for frame in sent:
            if frame.frame_id != message.frame_id:
                yield frame
                continue
            if not left and rng.random() < PART / self.burst:
                left = self.burst
                by = float(rng.choice([-1.0, 1.0])) * OFF[self.signal][self.amplitude == "large"]
                to = float(rng.uniform(low, high))
            if left:
                left -= 1
                values: Any = message.decode(frame.data, decode_choices=False)
                value = to if self.amplitude == "anything" else float(values[self.signal]) + by
                values[self.signal] = min(max(value, low), high)
                yield frame._replace(data=bytes(message.encode(values)))
            else:
                yield frame


MESSAGES = [sender.message for sender in (*load_dbc().controllers, load_dbc().sensor_box)]
DIRTS = tuple(Dirt(*each) for each in product(OFF, BURSTS, AMPLITUDES))


def vehicle(shop: Workshop) -> Record:
    """All drives of one vehicle; none where the workshop's tuning refuses it."""
    start, busy = time.monotonic(), time.process_time()
    drives: list[Record] = []
    refused = None
    try:
        bundle = shop.bundle()
        for k, fault in enumerate((None, *FAULTS)):
            drives += _drives(shop.number, bundle, k, fault)
    except InputError as error:
        refused = str(error)
    spent = {"wall_s": round(time.monotonic() - start, 1), "cpu_s": round(time.process_time() - busy, 1)}
    return {"vehicle": shop.number, "effects": hidden(shop.number, shop.effects_set), "refused": refused,
            "drives": drives, **spent}  # fmt: skip


def _drives(number: int, bundle: Bundle, k: int, fault: tuple[str, float] | None) -> Iterator[Record]:
    """A clean drive, and the same with its samples dirtied in some ways."""
    kind: Kind = "free" if fault is None else "single"
    case = Case(number, set_of(number), kind, "", () if fault is None else (fault,), seed_of(number, 900 + k), SECONDS)
    sent = list(frames(case.request, load_dbc(), [run_of(case.request)]))
    name, onset_s = ("", SECONDS) if fault is None else (fault[0], case.onset_s)
    yield {"fault": name, "onset_s": onset_s, "dirt": None, "events": _told(bundle, sent)}
    for each, dirt in enumerate(DIRTS):
        if fault is None or each % EACH == k % EACH:
            rng = np.random.default_rng([number, k, each])
            told = _told(bundle, dirt.on(sent, rng))
            how = [dirt.signal, dirt.burst, dirt.amplitude]
            yield {"fault": name, "onset_s": onset_s, "dirt": how, "events": told}


def _told(bundle: Bundle, sent: Sequence[Frame] | Iterator[Frame]) -> list[Any]:
    """Time [s], transition and diagnoses of each event."""
    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, "dirty", bundle.id)
    events = list(monitor.log((f.t, f.frame_id, True, f.data) for f in sent))
    origin = monitor.origin_s or 0.0
    return [[round(origin + e.t_s, 1), e.transition, [said(d) for d in e.diagnoses]] for e in events]


def false(drive: Record) -> bool:
    """Return True if a diagnosis was told before there was a fault."""
    return any(what == "occurred" and t < drive["onset_s"] for t, what, _ in drive["events"])


def delay_s(drive: Record) -> float | None:
    """From the onset to the first diagnosis after it."""
    times = [t for t, what, _ in drive["events"] if what == "occurred" and t >= drive["onset_s"]]
    return times[0] - drive["onset_s"] if times else None


def right(drive: Record) -> bool:
    """Whether the fault is of rank 1 in the last diagnosis."""
    last = [rows for _, what, rows in drive["events"] if what in ("occurred", "refined")]
    return bool(last) and any(rank == 1 and name == drive["fault"] for name, rank, *_ in last[-1])


def page(records: Sequence[Record]) -> str:
    """The tables, of all vehicles that are there."""
    pairs = [(_clean(drive, record), drive) for record in records for drive in record["drives"] if drive["dirt"]]
    quiet = [(clean, drive) for clean, drive in pairs if not false(clean)]
    found = [(clean, drive) for clean, drive in quiet if clean["fault"] and right(clean)]
    lost = [drive for _, drive in found if delay_s(drive) is None or not right(drive)]
    late = [b - a for c, d in found if (a := delay_s(c)) is not None and (b := delay_s(d)) is not None]
    commit = ", ".join(sorted({record["commit"] for record in records}))
    refused = ", ".join(str(r["vehicle"]) for r in records if r["refused"]) or "none"
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), ""]
    lines += [
        f"{len(records)} vehicles, {len(pairs)} drives with dirt. Refused by the workshop's tuning: {refused}.",
        "",
    ]
    lines += ["| | wanted | measured |", "|---|---|---|"]
    lines.append(f"| a fault made of it | none | {exact_share(sum(false(d) for _, d in quiet), len(quiet))} |")
    lines.append(f"| a fault hidden by it | none | {exact_share(len(lost), len(found))} |")
    later = "-" if not late else f"median {np.median(late):.0f} s, 90 % below {np.quantile(late, 0.9):.0f} s"
    lines += [f"| found later than in the clean drive | - | {later} |", "", "## By signal and amplitude", ""]
    lines += ["A fault made, of drives; a fault hidden, of drives.", ""]
    lines += ["| signal | " + " | ".join(f"{a}, {_often(b)}" for a in AMPLITUDES for b in BURSTS) + " |"]
    lines.append("|---" * (1 + len(AMPLITUDES) * len(BURSTS)) + "|")
    for signal in OFF:
        cells = [_cell([signal, b, a], quiet, found) for a in AMPLITUDES for b in BURSTS]
        lines.append(f"| {signal} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _often(burst: int) -> str:
    return "alone" if burst == 1 else f"bursts of {burst}"


def _clean(drive: Record, record: Record) -> Record:
    """The drive that this one is a copy of."""
    return next(each for each in record["drives"] if each["dirt"] is None and each["fault"] == drive["fault"])


def _cell(dirt: list[Any], quiet: Sequence[tuple[Record, Record]], found: Sequence[tuple[Record, Record]]) -> str:
    made = [d for _, d in quiet if d["dirt"] == dirt]
    hid = [d for _, d in found if d["dirt"] == dirt]
    lost = sum(delay_s(d) is None or not right(d) for d in hid)
    return f"{sum(map(false, made))} of {len(made)}; {lost} of {len(hid)}"


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))
