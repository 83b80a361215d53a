"""What `faultline log` prints for people."""

from collections.abc import Sequence

from faultline.service.survey.columns import ColumnRow
from faultline.service.survey.document import MessageRow, Survey

_MOST_ROWS = 60  # of a table


def text_of(survey: Survey) -> str:
    """The text, of several lines."""
    parts = [_head(survey)]
    if survey.messages:
        parts.append(_table("messages", _messages(survey.messages, survey.has_times)))
    if survey.columns:
        parts.append(_table("columns", _columns(survey.columns)))
    if survey.senders:
        rows = [
            [each.channel, f"0x{each.address:02X}", str(each.frames), str(len(each.groups))] for each in survey.senders
        ]
        parts.append(_table("senders (J1939)", [["channel", "address", "frames", "groups"], *rows]))
    gaps = [
        [each.channel, each.identifier, f"{gap.at_s:.1f}", f"{gap.for_s:.1f}", f"{each.period_s or 0.0:.3f}"]
        for each in survey.messages
        for gap in each.gaps
    ]
    if gaps:
        parts.append(_table("gaps", [["channel", "identifier", "from s", "for s", "period s"], *gaps]))
    if survey.signals:
        rows = [
            [
                each.signal,
                each.message,
                "yes" if each.is_there else "no",
                " ".join(each.channels),
                " ".join(f"0x{sender:02X}" for sender in each.senders),
                each.why,
            ]
            for each in sorted(survey.signals, key=lambda each: (each.is_there, each.message, each.signal))
        ]
        there = sum(each.is_there for each in survey.signals)
        title = f"signals: {there} of {len(survey.signals)} are there"
        parts.append(_table(title, [["signal", "message", "there", "channel", "senders", "why not"], *rows]))
    return "\n\n".join(parts)


def _head(survey: Survey) -> str:
    span = f"0.0 to {survey.length_s:.1f} s" if survey.has_times else "without times"
    channels = ", ".join(f"{each.name} ({each.frames})" for each in survey.channels)
    counts = f"{survey.frames} data, {survey.remote} remote and {survey.errors} error frames"
    if not channels:
        counts = f"{survey.frames} rows"
    lines = [
        f"{survey.file}: {survey.format}, {counts}, {span}",
        *([f"channels: {channels}"] if channels else []),
        *(f"damage: {sentence}" for sentence in survey.damage.sentences),
    ]
    if not survey.damage.sentences:
        lines.append("damage: none was found")
    return "\n".join(lines)


def _messages(messages: Sequence[MessageRow], has_times: bool) -> list[list[str]]:
    rows = [["channel", "identifier", "PGN", "frames", "rate 1/s", "period s", "bytes"]]
    for each in messages:
        length = str(each.longest) if each.shortest == each.longest else f"{each.shortest} to {each.longest}"
        rate = f"{each.rate_hz:.2f}" if has_times and each.rate_hz is not None else ""
        period = f"{each.period_s:.3f}" if has_times and each.period_s is not None else ""
        pgn = "" if each.pgn is None else str(each.pgn)
        rows.append([each.channel, each.identifier, pgn, str(each.count), rate, period, length])
    return rows


def _columns(columns: Sequence[ColumnRow]) -> list[list[str]]:
    rows = [["column", "unit", "values", "no numbers", "from s", "to s", "period s", "least", "greatest"]]
    for each in columns:
        numbers = each.first_s, each.last_s, each.period_s, each.least, each.greatest
        shown = ["" if number is None else f"{number:.6g}" for number in numbers]
        rows.append([each.name, each.unit, str(each.count), str(each.not_numbers or ""), *shown])
    return rows


def _table(title: str, rows: Sequence[Sequence[str]]) -> str:
    shown = rows[: _MOST_ROWS + 1]
    widths = [max(len(row[k]) for row in shown) for k in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in shown]
    if len(rows) > len(shown):
        lines.append(f"... and {len(rows) - len(shown)} more: --json has all")
    return "\n".join([f"{title}:", *(f"  {line}" for line in lines)])
