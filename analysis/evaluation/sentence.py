"""A verdict in a line, and several in one."""

from collections.abc import Sequence

from faultline.analysis.evaluation.judge import Verdict
from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.measure.intervals import at_most


def sentence(v: Verdict) -> str:
    """What became of one recording."""
    blind = f"; {', '.join(v.blind)} could never tell" if v.blind else ""
    if not v.faults:
        return f"{v.recording}: fault-free, {v.false_alarms} false alarms{blind}"
    found = (
        f"detected after {v.delay_s:g} s, isolated {{{', '.join(v.isolated)}}}, first {', '.join(v.first)}"
        if v.detected
        else "not detected"
    )
    fault = f"{', '.join(v.faults)} from {v.onset_s:g} s"
    return f"{v.recording}: {fault}, {found}; {v.false_alarms} false alarms before{blind}"


def summary(of: Sequence[Facts]) -> str:
    """What became of several."""
    faulty = [one for one in of if one.verdict.faults]
    detected = sum(one.verdict.detected for one in faulty)
    contained = sum(one.told.rank is not None for one in faulty)
    alone = sum(one.told.alone for one in faulty)
    false, free = sum(one.verdict.false_alarms for one in of), sum(one.free_hours for one in of)
    hours, most = sum(float(one.hours.sum()) for one in of), at_most(false, free)
    bound = f" (95 %: at most {most:.2g} an hour)" if most is not None else ""
    return (
        f"{len(of)} recordings, {hours:.1f} h: {detected} of {len(faulty)} faults detected, the true diagnosis among "
        f"those told of {contained}, first alone of {alone}; {false} false alarms in {free:.1f} h{bound}"
        f"{never([one.verdict for one in of])}"
    )


def never(of: Sequence[Verdict]) -> str:
    """The tests that could never tell in some of the recordings, as the end of a sentence."""
    blind = [*dict.fromkeys(test for verdict in of for test in verdict.blind)]
    count = sum(bool(verdict.blind) for verdict in of)
    return f"; {', '.join(blind)} could never tell in {count} of {len(of)} recordings" if blind else ""
