"""A refused bundle is tried again ever less often, and at once when a reload is asked for."""

import errno
from pathlib import Path
from types import SimpleNamespace
from typing import cast

from faultline.service.bundle.load import Bundle
from faultline.service.daemon.config import BundleConfig
from faultline.service.daemon.pipeline import BusChannel
from faultline.service.daemon.refused import AGAIN_S, LONGEST_S, Loader, RefusedBundles

BUNDLE = BundleConfig(path="/slots/current", bus="can0")
LINE = cast(BusChannel, SimpleNamespace(name="can0", bundles=[], welcome=list))


class Damaged(Loader):
    """Loads nothing, and counts how often that was asked."""

    def __init__(self) -> None:
        super().__init__(lambda: None)
        self.tries = 0

    def or_spare(self, path: Path) -> tuple[Bundle | None, str]:
        self.tries += 1
        return None, f"{path}: damaged"


def refused_and_loader() -> tuple[RefusedBundles, Damaged]:
    load = Damaged()
    return RefusedBundles({BUNDLE: "damaged"}, load, "truck", 1.0), load


def looked(refused: RefusedBundles, load: Damaged, seconds: int, begin: int = 0) -> list[int]:
    """The seconds at which it was tried, of looks every second."""
    tried = []
    for now in range(begin, begin + seconds):
        before = load.tries
        refused.look(float(now), [LINE], lambda *_: None, lambda *_: None)
        if load.tries > before:
            tried.append(now)
    return tried


def test_it_is_tried_after_five_seconds_and_then_ever_less_often() -> None:
    tried = looked(*refused_and_loader(), seconds=2000)
    waits = [b - a for a, b in zip([0, *tried], tried, strict=False)]
    assert waits[:4] == [AGAIN_S, 2 * AGAIN_S, 4 * AGAIN_S, 8 * AGAIN_S]
    assert waits[-3:] == [LONGEST_S] * 3
    assert waits == sorted(waits)


def test_a_reload_tries_at_once_and_begins_the_back_off_anew() -> None:
    refused, load = refused_and_loader()
    last = looked(refused, load, seconds=1000)[-1]
    refused.hurry()
    tried = looked(refused, load, seconds=30, begin=last + 10)
    assert tried[0] == last + 10
    assert tried[1] - tried[0] == 2 * AGAIN_S


def test_why_it_is_refused_now_is_the_condition() -> None:
    refused, load = refused_and_loader()
    assert [condition.of for condition in refused.conditions] == ["damaged"]
    looked(refused, load, seconds=10)
    assert [condition.of for condition in refused.conditions] == ["/slots/current: damaged"]


def test_an_error_of_the_system_refuses_a_bundle_and_ends_nothing(tmp_path: Path) -> None:
    """No descriptor is left, or a folder may not be read."""

    def short() -> None:
        raise OSError(errno.EMFILE, "Too many open files", str(tmp_path))

    bundle, why = Loader(short).or_spare(tmp_path)
    assert bundle is None
    assert "Too many open files" in why
