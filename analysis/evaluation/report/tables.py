"""The tables of the page, each from the evaluation's data."""

from collections.abc import Callable, Sequence

from faultline.analysis.evaluation.blocks import ALL
from faultline.analysis.evaluation.measure.isolation import columns
from faultline.analysis.evaluation.measure.selection import Selection
from faultline.analysis.evaluation.measure.signature import Cell
from faultline.analysis.evaluation.measure.sizes import PART
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.report.wording import NONE, between, hourly, number, percent, seconds
from faultline.service.core.manifest import EDGE
from faultline.service.pages import Row, Table, Td


def glance(e: Evaluation) -> Table:
    """The benchmarks' figures."""
    s = e.told.scores
    rows = [
        ["true detection rate (TDR)", percent(s.tdr)],
        ["false alarm rate (FAR)", percent(s.far)],
        ["fault isolation accuracy (FIA)", number(s.fia)],
        ["true isolation rate", percent(s.true_isolation)],
        ["false isolation rate", percent(s.false_isolation)],
        ["false alarms told", f"{e.told.false_alarms.events} ({hourly(e.told.false_alarms)})"],
    ]
    return Table(["figure", "value"], rows, "Figures of the DX 2025 challenge and of DAMADICS over all recordings.")


def recordings(e: Evaluation) -> Table:
    """Each with its verdict."""
    rows: list[Row] = []
    for one in e.recordings:
        v = one.verdict
        rows.append(
            [
                one.id,
                one.case,
                f"{one.fault_free_hours + one.faulty_hours:.2f}",
                str(v.false_alarms),
                seconds(v.delay_s),
                seconds(one.detection_s),
                seconds(one.isolation_s),
                ", ".join(v.first) or NONE,
                ", ".join(name for name in v.isolated if name not in v.first) or NONE,
                ", ".join(v.blind) or NONE,
            ]
        )
    head = ["recording", "truth", "hours", "false alarms", "delay", "detection time", "isolation time"]
    caption = "What was told at the end of each recording; delay: from the onset to the first diagnosis that is new."
    return Table([*head, "rank 1", "further", "could never tell"], rows, caption, text=(1, 7, 8, 9))


def confusion(e: Evaluation) -> Table:
    """True case against the explanations of rank 1."""
    names = columns(e.isolation, [*e.faults])
    rows: list[Row] = [
        [
            f"{row.case} (n {row.recordings})",
            *(_weight(row.told.get(name, 0.0), name == row.true) for name in names),
        ]
        for row in e.isolation
    ]
    caption = (
        "Rows: what was there; columns: what was told at the end, as the mean probability given to it (shared equally "
        "by the diagnoses of rank 1 where none is told). Framed: the true diagnosis."
    )
    return Table(["truth", *names], rows, caption)


def _weight(weight: float, true: bool) -> Td:
    return Td(f"{weight:.2f}" if weight else "", tint=weight, framed=true)


def faults(e: Evaluation) -> Table:
    """Which component each fault is of."""
    rows = [[name, words] for name, words in e.faults.items()]
    return Table(["fault", "component"], rows, "Faults that the bundle knows, with their components.", text=(1,))


def isolation(e: Evaluation) -> Table:
    """Detection, rank, probability and size of the diagnosis by case."""
    rows: list[Row] = [
        [
            row.case,
            Td(f"{row.detected.hits} of {row.recordings}", between(row.detected)),
            seconds(row.median_delay_s),
            Td(f"{row.contained.hits} of {row.recordings}", between(row.contained)),
            Td(f"{row.alone.hits} of {row.recordings}", between(row.alone)),
            _listed(row.ranks),
            _listed([f"{p:.2f}" for p in row.p]),
            _listed(row.sizes),
            number(row.scores.fia),
            percent(row.scores.true_isolation),
            percent(row.scores.false_isolation),
        ]
        for row in e.isolation
    ]
    head = ["truth", "detected", "delay, median", "true one contained", "alone of rank 1", "its rank", "its p", "size"]
    caption = (
        "By fault. Rank, p and size (number of diagnoses) are those at the end of each recording; p where it is told."
    )
    return Table([*head, "FIA", "true isolation", "false isolation"], rows, caption)


def sizes(e: Evaluation) -> Table:
    """Sizes told beside the true ones."""
    told = [(one, one.size) for one in e.recordings if one.size is not None]
    rows: list[Row] = [
        [
            one.id,
            one.case,
            f"{size.low:g} to {size.high:g} {size.unit}",
            size.of or NONE,
            NONE if size.true is None else f"{size.true:g} {size.unit}",
            NONE if size.covered is None else ("yes" if size.covered else "no"),
        ]
        for one, size in told
    ]
    known = [size.covered for _, size in told if size.covered is not None]
    caption = (
        f"Intervals of 95 % told at the end of each recording of a single fault; {sum(known)} of {len(known)} have "
        "the true size."
    )
    return Table(["recording", "truth", "told", "of", "true", "in it"], rows, caption, text=(1, 3))


def reached(e: Evaluation) -> Table:
    """Delays beside the limit's."""
    rows: list[Row] = [
        [
            one.case,
            Td(f"{one.detected.hits} of {one.recordings}", between(one.detected)),
            seconds(one.delay_s),
            seconds(one.limit_s),
            NONE if one.delay_s is None or one.limit_s is None else f"{one.delay_s / one.limit_s:.1f}",
            NONE if one.smallest is None else _with_unit(one.smallest, one.unit),
        ]
        for one in e.reached
    ]
    within = f"smallest within {e.limits.times_s[-1]:g} s" if e.limits else "smallest"
    caption = (
        "By fault: the median delay, and what any detector could reach at best in the fault-free recordings, with one "
        f"alarm in {e.limits.every_h:g} h without a fault; then the smallest size that it could find."
        if e.limits
        else ""
    )
    return Table(["truth", "detected", "delay, median", "limit", "times the limit", within], rows, caption)


def _with_unit(size: float, unit: str) -> str:
    return f"{100.0 * size:.3g} %" if unit == PART else f"{size:.3g} {unit}".rstrip()


def _listed(values: Sequence[object]) -> str:
    return ", ".join(map(str, values)) or NONE


def fault_free(e: Evaluation) -> Table:
    """False alarms of each generator."""
    rows: list[Row] = [
        [
            test.generator,
            test.predicts,
            NONE if test.rms is None else test.shown(test.rms).difference(test.rms),
            Td(f"{test.alarms.events} in {test.alarms.hours:.2f} h", hourly(test.alarms)),
            Td(percent(test.blocks.p), between(test.blocks), tint=test.blocks.p or 0.0),
            percent(test.cannot_tell),
            test.equals if test.equals != test.generator else "",
        ]
        for test in e.tests
    ]
    caption = (
        "Alarms of a detector are suspicions and are not told by themselves. Same signal as: numerically, within a "
        "tenth, in every recording."
    )
    head = ["generator", "predicts", "residual, RMS", "alarms", "blocks with an alarm", "cannot tell", "same signal as"]
    return Table(head, rows, caption)


def signature(e: Evaluation) -> Table:
    """Probability of alarm."""
    caption = (
        "Share of the blocks in which a generator alarms, with its 95 % interval; n: blocks in which it could tell. "
        "Framed: the test is sensitive by structure; a dark cell without a frame is an alarm that structure does not "
        "expect, or a false one. The first column is fault-free."
    )
    free = {test.generator: test.blocks for test in e.tests}

    def cell(c: Cell) -> Td:
        return Td(percent(c.alarm.p), between(c.alarm), tint=c.alarm.p or 0.0, framed=bool(c.sensitive))

    return _grid(
        e,
        caption,
        cell,
        ("fault-free", lambda name: Td(percent(free[name].p), between(free[name]), free[name].p or 0.0)),
    )


def delays(e: Evaluation) -> Table:
    """From the onset to the first alarm."""
    caption = (
        "Median delay from the onset to the first alarm that began after it; below, in how many recordings there was "
        "one, and in how many a false one stood at the onset already. All delays are in report.json. Framed: sensitive "
        "by structure."
    )

    def cell(c: Cell) -> Td:
        stood = f", {c.standing} stood" if c.standing else ""
        return Td(seconds(c.median_delay_s), f"{len(c.delays_s)} of {c.recordings}{stood}", framed=bool(c.sensitive))

    return _grid(e, caption, cell)


def blind(e: Evaluation) -> Table:
    """Share of *cannot tell*."""
    caption = "Share of the time with the fault in which a generator cannot tell: silence there is no peace."
    free = {test.generator: test.cannot_tell for test in e.tests}

    def cell(c: Cell) -> Td:
        return Td(percent(c.cannot_tell), tint=c.cannot_tell or 0.0, framed=bool(c.sensitive))

    return _grid(e, caption, cell, ("fault-free", lambda name: Td(percent(free[name]), tint=free[name])))


def _grid(
    e: Evaluation, caption: str, of: Callable[[Cell], Td], first: tuple[str, Callable[[str], Td]] | None = None
) -> Table:
    """Generators down, cases across, with another column `first` if wanted."""
    cases = [*dict.fromkeys(cell.case for cell in e.cells)]
    found = {(cell.generator, cell.case): cell for cell in e.cells}
    rows: list[Row] = [
        [test.generator, *([first[1](test.generator)] if first else []), *(of(found[test.generator, c]) for c in cases)]
        for test in e.tests
    ]
    return Table(["generator", *([first[0]] if first else []), *cases], rows, caption)


def by_mode(e: Evaluation) -> Table:
    """Area under the curve by operating mode, over the cases that a generator is sensitive to."""
    scored = (ALL, *(mode for mode in e.mode_hours if mode != EDGE))
    rows: list[Row] = []
    for test in e.tests:
        own = [cell for cell in e.cells if cell.generator == test.generator and cell.sensitive]
        cells: list[str | Td] = []
        for name in scored:
            areas = [area for cell in own if (area := cell.auc[name]) is not None]
            worst = min(areas, default=None)
            cells.append(Td(number(sum(areas) / len(areas) if areas else None), f"least {number(worst)}"))
        rows.append([test.generator, *cells])
    caption = (
        "Area under the curve by operating mode: mean over the faults (by size) that the test is sensitive to by "
        "structure, and the least of them. Each is in report.json."
    )
    return Table(["generator", *scored], rows, caption)


def areas(e: Evaluation) -> Table:
    """Area under the curve of each generator and fault, over all modes but the edge."""
    caption = (
        "Area under the curve over all modes but the edge. Framed: sensitive by structure; others should be at 0.5."
    )

    def cell(c: Cell) -> Td:
        area = c.auc[ALL]
        return Td(number(area), tint=max(2.0 * (area or 0.5) - 1.0, 0.0), framed=bool(c.sensitive))

    return _grid(e, caption, cell)


def several(e: Evaluation) -> bool:
    """Return whether some test has more than one generator."""
    return len({test.test for test in e.tests}) < len(e.tests)


def methods(e: Evaluation) -> Table:
    """Equations beside networks."""
    tests = {test.generator: test for test in e.tests}
    rows: list[Row] = [
        [
            f"{m.test}: {m.generator}",
            NONE if m.rms is None else tests[m.generator].shown(m.rms).difference(m.rms),
            Td(percent(m.false.p), between(m.false)),
            Td(percent(m.found.p), between(m.found)),
            Td(percent(m.crossed.p), between(m.crossed)),
            number(m.auc),
            percent(m.cannot_tell),
        ]
        for m in e.methods
    ]
    head = ["test: generator", "residual, RMS", "false: fault-free", "found: sensitive", "crossed: decoupled", "AUC"]
    caption = (
        "Generators of the same test. Blocks with an alarm: without a fault, with faults that the test is sensitive "
        "to, with faults that it decouples. Together: either alarms. Networks raise suspicion and are no conflicts."
    )
    return Table([*head, "cannot tell"], rows, caption)


def requirements(s: Selection) -> Table:
    """What the generators to keep must do."""
    rows = [
        [
            f"{r.case}: {'detected' if r.other is None else f'isolated from {r.other}'}",
            ", ".join(r.met_by),
        ]
        for r in s.requirements
    ]
    return Table(["requirement", "met by"], rows, "Each needs one generator of its row.", text=(1,))
