"""Operating points: each pair of signals when the system was learnt, and when it was judged (thesis fig. 6.15)."""

from collections.abc import Iterator, Sequence

from faultline.analysis.evaluation.report.figures.axes import FAULTY, FREE, Drawn, Pair, grid
from faultline.analysis.evaluation.story import Array
from faultline.service.core.display import display_of

MOST = 6
"""Signals: of more the first ones of the bundle are drawn."""


def draw(drawn: Sequence[Pair], made_from: Sequence[tuple[str, Array]]) -> Iterator[Drawn]:
    """Every pair of signals: of recordings that the bundle was `made_from` (K, signals), and with each fault.

    Without those, the fault-free recordings that are shown stand for them, and the caption says so.
    """
    faulty = [(story, one) for story, one in drawn if one.case.faults]
    free = [(story.recording, story.z) for story, one in drawn if not one.case.faults]
    before = list(made_from) or free
    if not before or not drawn:
        return
    inputs = drawn[0][0].bundle.manifest.inputs[:MOST]
    N = len(inputs)
    if N < 2:
        return
    figure, axes = grid(N - 1, N - 1, width=2.4, height=2.0)
    for down in range(1, N):
        for across in range(N - 1):
            panel = axes[down - 1, across]
            if across >= down:
                panel.set_visible(False)
                continue
            x, y = display_of(inputs[across]), display_of(inputs[down])
            for z in [z for _, z in before]:
                panel.plot(x.scaled(z[:, across]), y.scaled(z[:, down]), ".", color=FREE, markersize=1.2, alpha=0.5)
            for story, one in faulty:
                z = story.z[story.t_s >= (one.verdict.onset_s or 0.0)]
                panel.plot(x.scaled(z[:, across]), y.scaled(z[:, down]), ".", color=FAULTY, markersize=1.2, alpha=0.4)
            panel.tick_params(labelsize=6)
            if across == 0:
                panel.set_ylabel(f"{inputs[down].signal} [{y.unit}]", fontsize=7)
            if down == N - 1:
                panel.set_xlabel(f"{inputs[across].signal} [{x.unit}]", fontsize=7)
    names = ", ".join(name for name, _ in before)
    what = (
        "that the bundle was made from" if made_from else "that are shown without a fault (the others were not given)"
    )
    cases = ", ".join(one.case.label for _, one in faulty) or "none"
    alt = f"Operating points of {', '.join(one.signal for one in inputs)}: {names}; with faults: {cases}."
    caption = (
        f"Operating points, every sample: blue, of the recordings {what}: {names}; orange, after the onset of a "
        f"fault: {cases}. Where orange has no blue below it a network was never trained: what it predicts there is a "
        "guess, and its sigma should say so."
    )
    yield figure, alt, caption
