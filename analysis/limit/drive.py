"""A fault-free drive as block means with the shifts of all hypotheses, through the bundle's own generators."""

from collections.abc import Callable, Iterable

from faultline.service.bundle.load import Bundle
from faultline.service.core.decision.blocks import Block, BlockMeans
from faultline.service.core.decision.decision import Decision
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Event
from faultline.service.core.residuals.observer import Tick
from faultline.service.logs import Log

FEWEST = 10
"""A drive has at least so many blocks: half a minute, with 3 s each."""


def blocks_of(bundle: Bundle, log: Log) -> list[Block]:
    """Return the blocks of a drive.

    Raises:
        InputError: it has too few of them.
    """
    found = blocks_from(bundle, log.id, lambda monitor: monitor.signals(log.signals(bundle.table)))
    if len(found) < FEWEST:
        raise InputError(f"{log.id}: has {len(found)} steady blocks, a limit needs {FEWEST}; give a longer drive")
    return found


def blocks_from(bundle: Bundle, name: str, drive: Callable[[Monitor], Iterable[Event]]) -> list[Block]:
    """Return the blocks of what `drive` gives a fresh monitor, whatever their number."""
    manifest = bundle.manifest
    names = [generator.name for generator in manifest.generators]
    cut, found = BlockMeans(manifest.evidence, names, manifest.time), list[Block]()

    def watch(tick: Tick, decision: Decision) -> None:
        del decision
        block = cut.add(tick.number, tick.mode, tick.residuals)
        if block is not None:
            found.append(block)

    for _ in drive(Monitor(manifest, bundle.bank(), bundle.table, name, bundle.id, watch)):
        pass
    return found
