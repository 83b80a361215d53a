"""Pictures of traces as geometry in pixels, which `picture.svg.j2` draws as inline SVG."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from faultline.service.core.display import Display, display_of, titled
from faultline.service.protocol.live import SystemDescription
from faultline.service.workshop.trace import Sample

WIDTH, LEFT, RIGHT = 720, 70, 8
HEIGHT = 150  # of a signal's picture
ROW = 26  # of a test's line
SHADES = ("#ffffff", "#e4e4e4", "#c4c4c4", "#d4d4d4", "#b4b4b4")
"""Of the steady modes, in turn."""
AT_EDGE = "#f4f4f4"
DASHES = ("5 3", "2 2", "8 3 2 3", "1 3", "10 4")
SUMS = "Sum of each test in parts of its threshold, held at -2 and 2; alarm beyond the dashed lines, -1 and 1."

Point = tuple[float, float | None]
Label = tuple[float, float, str, str]


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


class Picture(NamedTuple):
    """A picture with its title, for those who cannot see it, and its caption.

    A shade is a part of the background over the whole height: x, width, fill. A level is a horizontal line: y, colour,
    dashes. A curve has the commands of an SVG path, its width and dashes. A label has x, y, anchor and words.
    """

    title: str
    caption: str
    height: int
    shades: Sequence[tuple[float, float, str]]
    levels: Sequence[tuple[float, str, str]]
    curves: Sequence[tuple[str, float, str]]
    labels: Sequence[Label]
    width: int = WIDTH
    left: int = LEFT
    right: int = WIDTH - RIGHT


def signals(system: SystemDescription, samples: Sequence[Sample]) -> list[Picture]:
    """Return a picture of each signal that tests predict: what was measured and predicted."""
    pictures = []
    for column, channel in enumerate(system.inputs):
        rows = [k for k, row in enumerate(system.generators) if row.predicts == channel.signal]
        if not rows:
            continue
        shown = display_of(channel)
        measured = [(each.t_s, _value(each.z[column], shown)) for each in samples]
        predicted = [[(each.t_s, _value(each.y_hat[k], shown)) for each in samples] for k in rows]
        tests = ", ".join(f"{system.generators[k].test} {DASHES[n % len(DASHES)]}" for n, k in enumerate(rows))
        caption = f"{titled(channel)} [{shown.unit}]: measured (whole line), predicted (dashes in px: {tests})"
        pictures.append(
            _signal(f"{channel.signal} over the cycle", caption, samples, measured, predicted, system.steady)
        )
    return pictures


def sums(system: SystemDescription, samples: Sequence[Sample]) -> Picture:
    """Return a line for each test: its detector's sum in parts of the threshold, which is at the dashed lines."""
    height = ROW * len(system.generators) + 20
    time = _time(samples)
    levels, curves, labels = list[tuple[float, str, str]](), list[tuple[str, float, str]](), list[Label]()
    for n, row in enumerate(system.generators):
        middle = ROW * (n + 0.5)
        level = Axis(-2.1, 2.1, middle + ROW * 0.46, middle - ROW * 0.46)
        labels.append((LEFT - 6, middle + 4, "end", row.name))
        levels += [(level(-1.0), "#888", "2 3"), (level(1.0), "#888", "2 3"), (level(0.0), "#bbb", "none")]
        curves.append((_path([(each.t_s, each.sums[n]) for each in samples], time, level), 1.2, "none"))
    labels += _times(time, height - 6)
    title = "sums of the tests in parts of their threshold"
    return Picture(title, SUMS, height, _shades(samples, time, system.steady), levels, curves, labels)


def _signal(
    title: str,
    caption: str,
    samples: Sequence[Sample],
    measured: list[Point],
    predicted: list[list[Point]],
    modes: Sequence[str],
) -> Picture:
    told = {
        t_s for line in predicted for t_s, value in line if value is not None
    }  # the rest would hide it: a start from 0
    known = [value for line in (measured, *predicted) for t_s, value in line if value is not None and t_s in told]
    known = known or [0.0, 1.0]
    margin = 0.05 * (max(known) - min(known)) or 0.1
    time, level = _time(samples), Axis(min(known) - margin, max(known) + margin, HEIGHT - 20, 6)
    ticks = [level.low + (level.high - level.low) * share for share in (0.1, 0.5, 0.9)]
    levels = [(level(value), "#bbb", "2 4") for value in ticks]
    labels = [(LEFT - 6, level(value) + 4, "end", f"{value:.3g}") for value in ticks]
    curves = [(_path(line, time, level), 0.8, DASHES[n % len(DASHES)]) for n, line in enumerate(predicted)]
    curves.append((_path(measured, time, level), 1.4, "none"))
    return Picture(
        title, caption, HEIGHT, _shades(samples, time, modes), levels, curves, [*labels, *_times(time, HEIGHT - 6)]
    )


def _value(value: float | None, shown: Display) -> float | None:
    return None if value is None else shown.scaled(value)


def _time(samples: Sequence[Sample]) -> Axis:
    ends = (samples[0].t_s, samples[-1].t_s) if samples else (0.0, 1.0)
    return Axis(*ends, LEFT, WIDTH - RIGHT)


def shade_by_mode(modes: Sequence[str]) -> dict[str, str]:
    """Return the background of each steady mode."""
    return {mode: SHADES[k % len(SHADES)] for k, mode in enumerate(modes)}


def _shades(samples: Sequence[Sample], time: Axis, modes: Sequence[str]) -> list[tuple[float, float, str]]:
    """Return the operating mode as shade of the background, for each visit."""
    starts = [k for k, each in enumerate(samples) if k == 0 or each.mode != samples[k - 1].mode]
    shade = shade_by_mode(modes)
    shades = []
    for start, end in zip(starts, [*starts[1:], len(samples) - 1], strict=True):
        left, right = time(samples[start].t_s), time(samples[end].t_s)
        shades.append((left, right - left, shade.get(samples[start].mode, AT_EDGE)))
    return shades


def _path(points: Iterable[Point], time: Axis, level: Axis) -> str:
    """Return the commands of a path with gaps where nothing is known."""
    path, pen = [], "M"
    for t_s, value in points:
        if value is not None:
            path.append(f"{pen}{time(t_s):.1f} {level(value):.1f}")
        pen = "M" if value is None else "L"
    return "".join(path)


def _times(time: Axis, y: float) -> list[Label]:
    at = [time.low + (time.high - time.low) * share for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    anchors = ("start", "middle", "middle", "middle", "end")
    return [(time(t), y, anchor, f"{t:.0f} s") for t, anchor in zip(at, anchors, strict=True)]
