"""Which channel of a log has the messages of a DBC, and which of several senders: what `[can]` says of them."""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping

from faultline.analysis.recordings.offered import Came
from faultline.fill_in import MARK
from faultline.service.core.j1939.identifiers import SOURCE_MASK, named
from faultline.service.logs import Log


def channels_text(messages: Mapping[str, Came], log: Log) -> Iterator[str]:
    """Yield the lines of `[can]` that say whose frames the messages are, where the log leaves that open."""
    channels = {name: found for name, found in log.report.channels.items() if found}
    on = {
        name: [channel for channel, found in channels.items() if found & each.identifiers]
        for name, each in messages.items()
        if each.identifiers
    }
    if len(channels) > 1 and on:
        yield from _channels(on)
    senders = {}
    for name, each in messages.items():
        layout = each.message.layout
        sources = sorted({identifier & SOURCE_MASK for identifier, _ in each.identifiers})
        if layout is not None and layout.j1939 and layout.is_from_any and len(sources) > 1:
            senders[name] = f"{MARK}: one of {', '.join(map(named, sources))}, without quotes"
    yield from _mapping("senders", senders)


def _channels(on: Mapping[str, list[str]]) -> Iterator[str]:
    """Yield the one channel that has all messages, or the buses of those that are on others."""
    counts = Counter(channel for channels in on.values() for channel in channels)
    everywhere = [channel for channel, count in counts.items() if count == len(on)]
    if len(everywhere) == 1:
        yield f"channel = {json.dumps(everywhere[0])}"
    elif everywhere:
        yield f'channel = "{MARK}: all messages are on {" and on ".join(everywhere)}"'
    else:
        main = counts.most_common(1)[0][0]
        others = {name: channels for name, channels in on.items() if main not in channels}
        buses = {re.sub(r"\W", "_", channel): channel for channels in others.values() for channel in channels}
        names = {channel: bus for bus, channel in buses.items()}
        yield f"channel = {json.dumps(main)}"
        yield from _mapping("buses", buses)
        yield from _mapping(
            "messages",
            {
                name: names[channels[0]]
                if len(channels) == 1
                else f"{MARK}: one of {', '.join(names[each] for each in channels)}"
                for name, channels in others.items()
            },
        )


def _mapping(key: str, values: Mapping[str, str]) -> Iterator[str]:
    """Yield a line of TOML, if there is anything to say; the keys are names of a DBC."""
    if values:
        yield f"{key} = {{ {', '.join(f'{name} = {json.dumps(value)}' for name, value in values.items())} }}"
