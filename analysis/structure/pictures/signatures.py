"""The fault signature matrix as a picture: which test is sensitive to which fault."""

from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from faultline.analysis.structure.isolability import signature_matrix
from faultline.analysis.structure.pictures.grid import Group, grid
from faultline.analysis.structure.pictures.style import BLUE, GREY, SKY, STYLE, box, finish, marker, tint
from faultline.analysis.structure.supports import Support, Test


@mpl.rc_context(STYLE)
def draw_signatures(tests: Sequence[Support], faults: Sequence[str], name: str = "the model") -> Figure:
    """Tests against faults, in the order given; the rows of the tests that can be run are highlighted."""
    runnable = {row for row, test in enumerate(tests) if isinstance(test, Test)}
    drawn = grid([test.name for test in tests], [Group("faults", tuple(faults))], banded=not runnable)
    cells = [(row, f) for row, hits in enumerate(signature_matrix(tests, faults)) for f, hit in enumerate(hits) if hit]
    for row in runnable:
        drawn.axes.fill_between(
            [-0.5, drawn.right], row - 0.5, row + 0.5, color=tint(SKY, 0.3), linewidth=0, zorder=0.5
        )
    drawn.mark([cell for cell in cells if cell[0] in runnable], BLUE, "marks-runnable")
    drawn.mark([cell for cell in cells if cell[0] not in runnable], GREY, "marks-other", size=0.42)
    for row, label in enumerate(drawn.axes.get_yticklabels()):
        label.set(fontweight="bold" if row in runnable else "normal", color=BLUE if row in runnable else GREY)
    handles: list[Artist] = []
    if runnable:
        handles += [marker(BLUE, "sensitive, the test can be run"), box(tint(SKY, 0.3), "test that can be run")]
    if len(runnable) < len(tests):
        handles.append(marker(GREY, "sensitive, the test cannot be run"))
    title = f"Fault signatures of {name}: {len(tests)} tests, {len(runnable)} of them can be run"
    return finish(drawn.figure, title, handles)
