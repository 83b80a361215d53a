"""New bundles are taken up while the service runs (SIGHUP, `systemctl reload`); what cannot be taken changes nothing.

What has been seen and is suspected stays where the new bundle decides alike (`core.compatibility`), as one does that
only has another version or signature; else its diagnosis begins anew, with the event `started`. Meanwhile frames wait
in the kernel's queue.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from faultline.service.bundle.files import Trust, one_line
from faultline.service.bundle.live import check_live
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.daemon.config import Config, load_config
from faultline.service.daemon.pipeline import BusChannel, Pipeline, check_buses, connect
from faultline.service.daemon.refused import NOT_TAKEN, Loader

FOR_A_RESTART = ("source", "bus", "bundle", "events", "store", "control", "memory")
"""Parts of the configuration that a reload leaves as they are."""


class Reload:
    """Reloads configuration, keys and bundles. `trust_of` gives the required signatures."""

    def __init__(
        self,
        path: Path,
        config: Config,
        lines: Sequence[BusChannel],
        trust_of: Callable[[Config], Trust | None],
        load: Loader,
        say: Callable[[str], None],
    ) -> None:
        self._path, self._config, self._lines = path, config, lines
        self._trust_of, self._load, self._say = trust_of, load, say

    def __call__(self, beat: Callable[[], None]) -> None:
        """Takes up what is there; `beat` is called after each bundle, which takes a part of a second."""
        try:
            config = load_config(self._path)
            trust = self._trust_of(config)
        except (InputError, OSError) as error:
            self._say(f"not reloaded: {one_line(error)}")
            return
        self._load.trust = lambda: self._trust_of(config)
        if changed := [name for name in FOR_A_RESTART if getattr(config, name) != getattr(self._config, name)]:
            self._say(
                f"{self._path}: {', '.join(changed)} changed: restart the service for that; bundles are looked at"
            )
        for line in self._lines:
            for watched in line.bundles:
                self._look_at(watched, line, trust)
                beat()

    def _look_at(self, watched: Pipeline, line: BusChannel, trust: Trust | None) -> None:
        here = watched.bundle
        try:
            bundle = load_bundle(Path(watched.place), trust)
            check_buses(bundle, [each.name for each in self._lines])
            if bundle.id == here.id:
                self._say(f"bundle {here.manifest.name} {here.id[:12]} is the one that runs")
                return
            check_live(bundle)
            alike = line.take_up(watched, bundle)
            connect(self._lines)
        except NOT_TAKEN as error:
            self._say(f"not taken up: {one_line(error)}; bundle {here.manifest.name} {here.id[:12]} goes on")
            return
        how = "goes on from where it was" if alike else "decides otherwise and begins anew"
        self._say(f"bundle {bundle.manifest.name} version {bundle.manifest.version} {bundle.id[:12]} taken up, {how}")
