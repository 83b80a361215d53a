"""Who sends the messages of SAE J1939: which frames carry them, whose they are, and where that is not certain.

A message of a DBC is of one source address, or of any (the null address, 0xFE, as vendors' files have it). Of any, it
is taken from the one that sends it. As soon as two do nobody knows which of them is meant, and none is believed until
one is chosen.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from faultline.service.core.j1939.identifiers import ADDRESS_CLAIMED, SOURCE_MASK, group_of, named
from faultline.service.core.signals.layout import Layout
from faultline.service.core.signals.values import Indices

SENDERS = 8
"""Source addresses of a message, other than the DBC's, that are remembered."""
NAME = 8
"""Bytes of a device's NAME (SAE J1939-81)."""


class Senders:
    """The messages of one table by their groups, and their senders.

    `counts`: frames by source address of each message that is taken from any; `others` and `other` are, of those with
    an address, how many frames came from others, and from which of them; `claimed` are claims of a sender's address by
    another device. By message, all of them; 256 addresses at most.
    """

    def __init__(self, layouts: Iterable[Layout]) -> None:
        self._layouts = tuple(layouts)
        self._groups: dict[int, list[Layout]] = {}
        for layout in sorted(self._layouts, key=lambda each: -each.mask.bit_count()):  # the most certain ones first
            self._groups.setdefault(group_of(layout.identifier), []).append(layout)
        self._names: dict[int, bytes] = {}  # of devices, by the address that they claimed
        self.counts: dict[str, Counter[int]] = {one.name: Counter() for one in self._layouts if one.is_from_any}
        self.others: dict[str, int] = {}
        self.other: dict[str, set[int]] = {}
        self.claimed: dict[str, int] = {}

    @property
    def groups(self) -> Mapping[int, Sequence[Layout]]:
        """Messages by the number of their group."""
        return self._groups

    @property
    def addresses(self) -> set[int] | None:
        """Source addresses of the messages; None where one of them is taken from any."""
        return None if self.counts else {layout.identifier & SOURCE_MASK for layout in self._layouts}

    def match(self, identifier: int) -> Layout | None:
        """Return the message that frames of this identifier carry."""
        found = self._groups.get(group_of(identifier), ())
        return next((each for each in found if not (identifier ^ each.identifier) & each.mask), None)

    def count_in(self, other: "Senders") -> None:
        """Count what is not taken where those of another bus are counted."""
        self.others, self.other, self.claimed = other.others, other.other, other.claimed

    def is_sole(self, layout: Layout, address: int) -> bool:
        """Count a frame of a message that is taken from any; False if more than one have sent it."""
        seen = self.counts[layout.name]
        seen[address] += 1
        return len(seen) == 1

    def count_sole(self, layout: Layout, addresses: Indices) -> int:
        """Count frames (K,) of a message that is taken from any; return how many came before a second one sent it."""
        seen = self.counts[layout.name]
        first = next(iter(seen), int(addresses[0]))
        other = addresses != first
        count = 0 if len(seen) > 1 else int(np.argmax(other)) if other.any() else len(addresses)
        for address, frames in zip(*np.unique(addresses, return_counts=True), strict=True):
            seen[int(address)] += int(frames)
        return count

    def take_others(self, identifiers: Indices) -> None:
        """Count frames (K,) that carry none of the messages and claim no address, as `take_other` does one by one."""
        found, first, counts = np.unique(identifiers, return_index=True, return_counts=True)
        for k in np.argsort(first):
            identifier = int(found[k])
            self.take_other(identifier, b"")
            for each in self._groups.get(group_of(identifier), ()):
                self.others[each.name] += int(counts[k]) - 1

    def take_other(self, identifier: int, data: bytes) -> None:
        """Count a frame that carries none of the messages: one of their groups from another sender, or a claim."""
        group, address = group_of(identifier), identifier & SOURCE_MASK
        for each in self._groups.get(group, ()):
            self.others[each.name] = self.others.get(each.name, 0) + 1
            seen = self.other.setdefault(each.name, set())
            if len(seen) < SENDERS:
                seen.add(address)
        if group == ADDRESS_CLAIMED and len(data) == NAME:
            self._claim(address, data)

    def _claim(self, address: int, name: bytes) -> None:
        """A device claims an address; who speaks under it from now on is another one if its NAME is."""
        theirs = [layout.name for layout in self._layouts if self._is_from(layout, address)]
        if (theirs or self.counts) and self._names.setdefault(address, name) != name:
            self._names[address] = name
            for message in theirs:
                self.claimed[message] = self.claimed.get(message, 0) + 1

    def _is_from(self, layout: Layout, address: int) -> bool:
        """Whether the message comes from there, as far as the DBC says so or it was seen."""
        if layout.is_from_any:
            return address in self.counts[layout.name]
        return layout.identifier & SOURCE_MASK == address

    def unclear(self, taken: Mapping[str, int]) -> list[str]:
        """Return what is to be decided about senders, a sentence each; `taken` are frames by message."""
        found = [text for name, seen in self.counts.items() if (text := _which(name, seen))]
        for layout in self._layouts:
            others = self.other.get(layout.name)
            if others and not layout.is_from_any and not taken[layout.name]:
                own = f"{layout.name} never came from {named(layout.identifier & SOURCE_MASK)}"
                there = ", ".join(map(named, sorted(others)))
                remedy = f"give the DBC that source address, or choose with --sender {layout.name}={named(min(others))}"
                found.append(f"{own}, its parameter group came from {there}: {remedy}")
        return found

    def sole(self) -> list[str]:
        """Return from whom the messages came that the DBC gives to any sender, where it was one."""
        return [f"{name} from {_listed(seen)}" for name, seen in self.counts.items() if len(seen) == 1]

    def undecided(self, identifiers: Collection[int]) -> list[str]:
        """Return, of all 29-bit identifiers of a log, which messages come from several senders, a sentence each."""
        seen: dict[str, Counter[int]] = {name: Counter() for name in self.counts}
        for identifier in identifiers:
            layout = self.match(identifier)
            if layout is not None and layout.is_from_any:
                seen[layout.name][identifier & SOURCE_MASK] = 0
        return [text for name, each in seen.items() if (text := _which(name, each))]


def _which(name: str, seen: Mapping[int, int]) -> str:
    """What to choose where a message comes from several senders; nothing where it does not."""
    if len(seen) < 2:
        return ""
    return (
        f"{name} comes from {_listed(seen)}, and the DBC does not say which one is meant: choose one, "
        f"as with --sender {name}={named(min(seen))}"
    )


def _listed(seen: Mapping[int, int]) -> str:
    """Addresses, with their frames where those are counted."""
    return ", ".join(
        f"{named(each)} ({count} frames)" if count else named(each) for each, count in sorted(seen.items())
    )
