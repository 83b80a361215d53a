"""The page of figures: every test over a cycle, under every fault, by mode, by operating point, by other bundles."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.report.figures import bundles, operating_points, overlaid, prediction
from faultline.analysis.evaluation.report.figures.axes import Drawn, Pair
from faultline.analysis.evaluation.report.page import origin
from faultline.analysis.evaluation.report.pictures import Picture, picture
from faultline.analysis.evaluation.story import Array, Story
from faultline.service.pages import render

TEMPLATE = Path(__file__).with_name("figures.html.j2")


class Part(NamedTuple):
    """A section: its title, what its pictures show, and these."""

    title: str
    words: str
    drawn: Sequence[Picture]


def page(
    e: Evaluation,
    drawn: Sequence[Pair],
    made_from: Sequence[tuple[str, Array]] = (),
    beside: Mapping[str, Sequence[Story]] | None = None,
    report: str = "report.html",
) -> str:
    """Return the page of the recordings `drawn`.

    `made_from` are samples (K, signals) of recordings that the bundle was made from, `beside` the stories of other
    bundles by their names; `report` is the file beside it that has the numbers.
    """
    parts = [
        _part(
            "Measured, predicted and residual of every test",
            "How well each test knows the sound system (thesis, figures 6.1 and 6.8).",
            prediction.over_cycle(e, drawn),
        ),
        _part(
            "Residuals under every fault, over the fault-free one",
            "What each fault does to each residual (figures 6.4 and 6.11).",
            overlaid.residuals(e, drawn),
        ),
        _part(
            "Each fault as one test sees it best",
            "Measured, predicted and residual of one fault (figures 6.5 and 6.12).",
            prediction.most_moved(e, drawn),
        ),
        _part(
            "Detectors over every recording",
            "Does each test alarm under the faults that it should see, and under no other? (figures 6.6 and 6.13)",
            overlaid.detectors(e, drawn),
        ),
        *(
            _part(
                f"Detectors in mode {mode} alone",
                f"The same, of the samples in this mode only (figures 6.7 and 6.14 are of the highest dose). {words}",
                overlaid.detectors(e, drawn, mode),
            )
            for mode, words in e.modes.items()
        ),
        _part(
            "Operating points",
            "Was the system, with a fault, where the bundle has learnt it? (figure 6.15)",
            operating_points.draw(drawn, made_from),
        ),
        _part(
            "By other bundles",
            "The same recordings by bundles trained once more, or with other recordings (figures 5.13, 6.16).",
            bundles.draw(e, drawn, beside or {}),
        ),
    ]
    return render(
        TEMPLATE, title=f"Figures of bundle {e.bundle}", e=e, origin=origin(e), parts=parts, report=report
    )  # fmt: skip


def _part(title: str, words: str, made: Iterable[Drawn]) -> Part:
    return Part(title, words, [picture(*each) for each in made])
