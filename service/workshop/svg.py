"""Traces as inline SVG: black on white, told apart by dashes, so that any printer will do."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

from faultline.service.workshop.answers import System
from faultline.service.workshop.trace import Sample
from faultline.service.workshop.units import scaled, unit_shown

WIDTH, LEFT, RIGHT = 720.0, 70.0, 8.0
HEIGHT = 150.0  # of a signal's picture
ROW = 26.0  # of a test's line
SHADES = {"idle": "#ffffff", "partial": "#e4e4e4", "maximum": "#c4c4c4", "edge": "#f4f4f4"}
DASHES = ("5 3", "2 2", "8 3 2 3", "1 3", "10 4")

Point = tuple[float, float | None]


class Axis(NamedTuple):
    """A linear map of `low`..`high` onto pixels `start`..`end`."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        """The pixel of a value, none beyond the picture."""
        share = (value - self.low) / (self.high - self.low) if self.high > self.low else 0.5
        return self.start + (self.end - self.start) * min(1.0, max(0.0, share))


def signals(system: System, samples: Sequence[Sample]) -> list[tuple[str, str]]:
    """Of each signal that tests predict: its caption, and a picture of what was measured and predicted."""
    pictures = []
    for column, channel in enumerate(system.inputs):
        rows = [k for k, row in enumerate(system.generators) if row.predicts == channel.signal]
        if not rows or not samples:
            continue
        measured = [(each.t_s, _value(each.z[column], channel.unit)) for each in samples]
        predicted = [[(each.t_s, _value(each.y_hat[k], channel.unit)) for each in samples] for k in rows]
        tests = ", ".join(f"{system.generators[k].test} {DASHES[n % len(DASHES)]}" for n, k in enumerate(rows))
        caption = (
            f"{channel.signal} [{unit_shown(channel.unit)}]: measured (whole line), predicted (dashes in px: {tests})"
        )
        pictures.append((caption, _signal(channel.signal, samples, measured, predicted)))
    return pictures


def sums(system: System, samples: Sequence[Sample]) -> str:
    """A line for each test: its detector's sum in parts of the threshold, which is at the dashed lines."""
    height = ROW * len(system.generators) + 20
    time = _time(samples)
    parts = [_head(height, "sums of the tests in parts of their threshold"), _modes(samples, time, height - 20)]
    for n, row in enumerate(system.generators):
        middle = ROW * (n + 0.5)
        level = Axis(-2.1, 2.1, middle + ROW * 0.46, middle - ROW * 0.46)
        parts.append(f'<text x="{LEFT - 6:.0f}" y="{middle + 4:.1f}" text-anchor="end">{escape(row.name)}</text>')
        parts += [_level(level(value), "#888", "2 3") for value in (-1.0, 1.0)] + [_level(level(0.0), "#bbb", "")]
        parts.append(_line([(each.t_s, each.sums[n]) for each in samples], time, level, 1.2, ""))
    return "".join([*parts, _times(time, height - 6), "</svg>"])


def _signal(name: str, samples: Sequence[Sample], measured: list[Point], predicted: list[list[Point]]) -> str:
    told = {
        t_s for line in predicted for t_s, value in line if value is not None
    }  # the rest would hide it: a start from 0
    known = [value for line in (measured, *predicted) for t_s, value in line if value is not None and t_s in told]
    known = known or [0.0, 1.0]
    margin = 0.05 * (max(known) - min(known)) or 0.1
    time, level = _time(samples), Axis(min(known) - margin, max(known) + margin, HEIGHT - 20, 6)
    ticks = [level.low + (level.high - level.low) * share for share in (0.1, 0.5, 0.9)]
    return "".join(
        [
            _head(HEIGHT, f"{name} over the cycle"),
            _modes(samples, time, HEIGHT - 20),
            *(_level(level(value), "#bbb", "2 4") for value in ticks),
            *(
                f'<text x="{LEFT - 6:.0f}" y="{level(value) + 4:.1f}" text-anchor="end">{value:.3g}</text>'
                for value in ticks
            ),
            *(_line(line, time, level, 0.8, DASHES[n % len(DASHES)]) for n, line in enumerate(predicted)),
            _line(measured, time, level, 1.4, ""),
            _times(time, HEIGHT - 6),
            "</svg>",
        ]
    )


def _value(value: float | None, unit: str) -> float | None:
    return None if value is None else scaled(value, unit)


def _time(samples: Sequence[Sample]) -> Axis:
    ends = (samples[0].t_s, samples[-1].t_s) if samples else (0.0, 1.0)
    return Axis(*ends, LEFT, WIDTH - RIGHT)


def _head(height: float, title: str) -> str:
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" aria-label="{escape(title, quote=True)}">'
        f"<title>{escape(title)}</title>"
    )


def _modes(samples: Sequence[Sample], time: Axis, height: float) -> str:
    """The operating mode as shade of the background, a rectangle for each visit."""
    parts, k = [], 0
    while k < len(samples):
        end = k
        while end + 1 < len(samples) and samples[end + 1].mode == samples[k].mode:
            end += 1
        left, right = time(samples[k].t_s), time(samples[min(end + 1, len(samples) - 1)].t_s)
        shade = SHADES.get(samples[k].mode, "#ffffff")
        parts.append(f'<rect x="{left:.1f}" y="0" width="{right - left:.1f}" height="{height:.0f}" fill="{shade}"/>')
        k = end + 1
    return "".join(parts)


def _level(y: float, colour: str, dash: str) -> str:
    return (
        f'<line x1="{LEFT:.0f}" x2="{WIDTH - RIGHT:.0f}" y1="{y:.1f}" y2="{y:.1f}" stroke="{colour}" '
        f'stroke-width="0.6" stroke-dasharray="{dash or "none"}"/>'
    )


def _line(points: Iterable[Point], time: Axis, level: Axis, width: float, dash: str) -> str:
    """A line with gaps where nothing is known."""
    path, pen = [], "M"
    for t_s, value in points:
        if value is None:
            pen = "M"
            continue
        path.append(f"{pen}{time(t_s):.1f} {level(value):.1f}")
        pen = "L"
    return (
        f'<path d="{"".join(path)}" fill="none" stroke="#000" stroke-width="{width}" '
        f'stroke-dasharray="{dash or "none"}"/>'
        if path
        else ""
    )


def _times(time: Axis, y: float) -> str:
    at = [time.low + (time.high - time.low) * share for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    anchors = ("start", "middle", "middle", "middle", "end")
    return "".join(
        f'<text x="{time(t):.1f}" y="{y:.1f}" text-anchor="{anchor}">{t:.0f} s</text>'
        for t, anchor in zip(at, anchors, strict=True)
    )
