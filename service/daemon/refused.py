"""Bundles that cannot be loaded: another slot stands in where there is one, and they are tried again with a back-off.

The service is up meanwhile, with its sockets and the condition `bundle-refused`: under a service manager an exit would
be a restart every few seconds, and nobody could ask why.
"""

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from faultline.service.bundle.files import Trust, one_line
from faultline.service.bundle.live import check_live
from faultline.service.bundle.load import Bundle, load_bundle
from faultline.service.bundle.slots import spare
from faultline.service.core.errors import InputError
from faultline.service.core.records.health import Condition
from faultline.service.daemon.config import BundleConfig
from faultline.service.daemon.pipeline import FAILURES, BusChannel, Pipeline, check_buses, connect, watched

AGAIN_S, LONGEST_S = 5.0, 300.0
"""A refused bundle is tried again after so long; twice as long each time, and `LONGEST_S` at most [s]."""
NOT_TAKEN: tuple[type[Exception], ...] = (InputError, OSError, *FAILURES)
"""OSError: no descriptor is left, or a folder may not be read: that is over some time, and ends no service."""


class Loader:
    """Loads the bundles of a configuration, signed by those whom `trust` names: keys are read at each try.

    A reload of the configuration sets `trust` anew. `buses` are the names of those that are configured.
    """

    def __init__(self, trust: Callable[[], Trust | None], buses: Collection[str] = ()) -> None:
        self.trust, self._buses = trust, buses

    def __call__(self, path: Path) -> Bundle:
        """Return the bundle in the folder, which computes its golden vectors; raises one of `NOT_TAKEN`."""
        bundle = load_bundle(path, self.trust())
        check_buses(bundle, self._buses)
        check_live(bundle)
        return bundle

    def or_spare(self, path: Path) -> tuple[Bundle | None, str]:
        """Return the bundle, else the one in the other slot, else None; and why it is not the first, or nothing."""
        try:
            return self(path), ""
        except NOT_TAKEN as error:
            why = one_line(error)
        try:
            other = spare(path)
            return (None if other is None else self(other)), why
        except NOT_TAKEN as error:
            return None, f"{why}; and of the other slot {one_line(error)}"


class RefusedBundles:
    """The bundles of a configuration that were refused, and why. State: when each is tried again."""

    def __init__(self, why: dict[BundleConfig, str], load: Loader, source: str, speed: float) -> None:
        """`why` by bundle; `source` is the vehicle's name, `speed` how many times real time its buses run."""
        self._why, self._load, self._source, self._speed = why, load, source, speed
        self._due: dict[BundleConfig, float | None] = dict.fromkeys(why)
        self._wait_s = dict.fromkeys(why, AGAIN_S)

    @property
    def conditions(self) -> set[Condition]:
        """Return a condition for each, with the reason."""
        return {Condition("bundle-refused", why) for why in self._why.values()}

    @property
    def places(self) -> list[str]:
        """Folder and bus of each, as `PLACE on BUS`."""
        return [f"{each.path} on {each.bus}" for each in self._why]

    def hurry(self) -> None:
        """Try all at the next look: a reload was asked for."""
        self._wait_s = dict.fromkeys(self._why, AGAIN_S)
        self._due = dict.fromkeys(self._why, -float("inf"))

    def look(
        self,
        now: float,
        lines: Sequence[BusChannel],
        say: Callable[[str], None],
        added: Callable[[BusChannel, Pipeline], None],
    ) -> None:
        """Try one whose time has come at the monotonic time `now` [s]; `added` is called with one that came up."""
        for each in [*self._why]:
            if (due := self._due[each]) is None:  # it has just been tried, when the service started
                self._due[each] = now + self._wait_s[each]
            elif now >= due:
                self._wait_s[each] = min(2.0 * self._wait_s[each], LONGEST_S)
                self._due[each] = now + self._wait_s[each]
                self._try(each, next(line for line in lines if line.name == each.bus), say, added)
                connect(lines)
                return  # a bundle takes a part of a second: one a look

    def _try(
        self,
        each: BundleConfig,
        line: BusChannel,
        say: Callable[[str], None],
        added: Callable[[BusChannel, Pipeline], None],
    ) -> None:
        bundle, why = self._load.or_spare(Path(each.path))
        running = next((one for one in line.bundles if one.place == each.path), None)
        try:
            if bundle is not None and running is None:
                running = watched(bundle, self._source, self._speed, place=each.path)
                line.add(running)
                added(line, running)
                say(f"bundle {bundle.manifest.name} {bundle.id[:12]} runs now")
            elif bundle is not None and running is not None and bundle.id != running.bundle.id:
                line.take_up(running, bundle)
                say(f"bundle {bundle.manifest.name} {bundle.id[:12]} taken up")
        except NOT_TAKEN as error:
            why = one_line(error)
        if not why:
            for kept in (self._why, self._due, self._wait_s):
                del kept[each]
        elif why != self._why[each]:
            self._why[each] = why
            say(f"refused: {why}")
