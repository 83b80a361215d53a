"""A new bundle is taken up by a service that runs: with what it has seen where it decides alike, else anew."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from made_bundle import GOLDEN, copied, edit
from ports import multicast

from faultline.service.bundle.files import Trust
from faultline.service.bundle.load import load_bundle
from faultline.service.bus import Bus, open_bus
from faultline.service.core.compatibility import are_compatible
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Manifest
from faultline.service.core.records.event import Event
from faultline.service.daemon.config import BundleConfig, BusConfig, Config, EventsConfig, TrustConfig
from faultline.service.daemon.pipeline import BusChannel, watched
from faultline.service.daemon.refused import Loader
from faultline.service.daemon.reload import Reload
from faultline.service.logs import Frame, open_log

CONFIG = """source = "truck"
[[bus]]
name = "powertrain"
interface = "socketcan:vcan0"
[[bundle]]
path = "{bundle}"
bus = "powertrain"
[trust]
allow_unsigned = true
[events]
socket = "{bundle}.sock"
"""
LOG = open_log(GOLDEN.parent / "log")
MIDDLE_S = 60.0


class Service:
    """A line with a bundle that can be changed, frames of the golden recording, and what is said."""

    def __init__(self, folder: Path, bus: Bus) -> None:
        self.bundle = copied(folder)
        self.path = folder / "faultline.toml"
        self.path.write_text(CONFIG.format(bundle=self.bundle))
        self.config = Config(
            bus=[BusConfig(name="powertrain", interface="socketcan:vcan0")],
            bundle=[BundleConfig(path=str(self.bundle), bus="powertrain")],
            trust=TrustConfig(allow_unsigned=True),
            events=EventsConfig(socket=f"{self.bundle}.sock"),
            source="truck",
        )
        self.said: list[str] = []
        self.line = BusChannel("powertrain", bus, [watched(load_bundle(self.bundle), "truck", 1.0)], self.said.append)
        self.trusted: list[InputError] = []
        self.reload = Reload(self.path, self.config, [self.line], self.trust, Loader(lambda: None), self.said.append)

    def trust(self, _: Config) -> Trust | None:
        for error in self.trusted:
            raise error
        return None

    def hears(self, begin_s: float, end_s: float) -> list[Event]:
        """The events that the recording makes between two of its times."""
        (watched_bundle,) = self.line.bundles
        return [event for frame in frames(begin_s, end_s) for event in watched_bundle.hear([frame])]


def frames(begin_s: float, end_s: float) -> Iterator[Frame]:
    relative = LOG.relative()
    for t, can_id, is_extended, data in relative:
        if begin_s <= t < end_s:
            yield Frame(t, can_id, is_extended, data)


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    with open_bus(multicast()) as bus:
        yield Service(tmp_path, bus)


def seen_by(service: Service, change: Any = None) -> list[tuple[float, str, list[tuple[str, ...]]]]:
    """What is told of the whole recording, where the bundle changes in the middle."""
    events = service.hears(0.0, MIDDLE_S)
    if change is not None:
        edit(service.bundle, change)
    service.reload(lambda: None)
    events += service.hears(MIDDLE_S, 1e9)
    return [(event.t_s, event.transition, [tuple(each.faults) for each in event.diagnoses]) for event in events]


def test_the_same_bundle_changes_nothing(service: Service) -> None:
    (before,) = service.line.bundles
    bundle = before.bundle
    service.reload(lambda: None)
    assert before.bundle is bundle
    assert "is the one that runs" in service.said[0]


def test_one_that_decides_alike_goes_on_from_where_it_was(service: Service, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    with open_bus(multicast()) as bus:
        undisturbed = Service(tmp_path / "other", bus)
        expected = seen_by(undisturbed)
    assert seen_by(service, lambda manifest: manifest.update(version=7)) == expected
    assert "version 7" in service.said[0]
    assert "goes on from where it was" in service.said[0]


def test_its_events_are_of_the_new_bundle(service: Service) -> None:
    service.hears(0.0, MIDDLE_S)
    edit(service.bundle, lambda manifest: manifest.update(version=7))
    service.reload(lambda: None)
    new = load_bundle(service.bundle).id
    events = service.hears(MIDDLE_S, 1e9)
    assert events
    assert {event.bundle for event in events} == {new}


def test_one_that_decides_otherwise_begins_anew(service: Service) -> None:
    def more_deaf(manifest: dict[str, Any]) -> None:
        manifest["detectors"][0]["J"] *= 2.0

    told = seen_by(service, more_deaf)
    assert "begins anew" in service.said[0]
    assert [transition for _, transition, _ in told].count("started") == 2


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda bundle: (bundle / "golden.json").write_text("{}"), "golden.json"),
        (lambda bundle: (bundle / "manifest.json").unlink(), "manifest.json: not found"),
    ],
)
def test_one_that_is_refused_leaves_the_other_at_work(service: Service, damage: Any, message: str) -> None:
    (before,) = service.line.bundles
    bundle = before.bundle
    damage(service.bundle)
    service.reload(lambda: None)
    assert before.bundle is bundle
    assert message in service.said[0]
    assert "goes on" in service.said[0]


def test_a_configuration_or_keys_that_are_refused_change_nothing(service: Service) -> None:
    (before,) = service.line.bundles
    bundle = before.bundle
    edit(service.bundle, lambda manifest: manifest.update(version=7))
    service.trusted = [InputError("keys: none there")]
    service.reload(lambda: None)
    service.trusted.clear()
    service.path.write_text("nonsense")
    service.reload(lambda: None)
    assert before.bundle is bundle
    assert service.said[0] == "not reloaded: keys: none there"
    assert "not TOML" in service.said[1]


def test_what_needs_a_restart_is_said(service: Service) -> None:
    service.path.write_text(CONFIG.format(bundle=service.bundle).replace("vcan0", "vcan1"))
    service.reload(lambda: None)
    assert "bus changed: restart the service" in service.said[0]


@pytest.mark.parametrize(
    ("change", "alike"),
    [
        ({"version": 9}, True),
        ({"name": "other"}, True),
        ({"period_s": 0.1}, False),
        ({"detectors": []}, False),
        ({"inputs": []}, False),
    ],
)
def test_what_makes_bundles_decide_alike(change: dict[str, object], alike: bool) -> None:
    manifest: Manifest = load_bundle(GOLDEN).manifest
    assert are_compatible(manifest, msgspec.structs.replace(manifest, **change)) is alike


def test_another_graph_decides_otherwise() -> None:
    manifest = load_bundle(GOLDEN).manifest
    name = manifest.graphs[0].file
    files = {**manifest.files, name: msgspec.structs.replace(manifest.files[name], sha256="0" * 64)}
    assert not are_compatible(manifest, msgspec.structs.replace(manifest, files=files))


def test_refused_bundles_are_tried_with_the_trust_of_the_reloaded_configuration(service: Service) -> None:
    """A key that was revoked was believed until a restart."""
    load = Loader(lambda: None)
    reload = Reload(service.path, service.config, [service.line], service.trust, load, service.said.append)
    reload(lambda: None)
    service.trusted.append(InputError("that key is trusted no more"))
    with pytest.raises(InputError, match="trusted no more"):
        load(service.bundle)
