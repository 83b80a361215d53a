"""Two slots: what is current stays so until the next one is whole, signed, newer and tried."""

import contextlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from made_bundle import edit, put

from faultline.service.bundle.command import main
from faultline.service.bundle.files import BundleError, whole
from faultline.service.bundle.signing import SignatureError, Signed, public_of, sign
from faultline.service.bundle.slots import CURRENT, SlotError, Slots, spare
from faultline.service.bundle.trial import trial
from faultline.service.core.errors import InputError
from faultline.service.daemon.refused import Loader

GOLDEN = Path(__file__).parents[2] / "golden" / "bundle"
KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
TRUST = Signed({public_of(KEY).id: public_of(KEY, "test.pub")})


def version(folder: Path, number: int, name: str = "uds", *, signed: bool = True, start_within_s: float = 60.0) -> Path:
    """The golden bundle as this version, signed."""
    bundle = Path(shutil.copytree(GOLDEN, folder / f"v{number}-{name}-{start_within_s}", dirs_exist_ok=True))
    edit(bundle, lambda manifest: manifest.update(version=number, name=name, start_within_s=start_within_s))
    if signed:
        raw = (bundle / "manifest.json").read_bytes()
        (bundle / f"manifest.{public_of(KEY).label}.minisig").write_text(sign(raw, KEY, "test"))
    return bundle


def passes(_folder: Path) -> None:
    return


def there(folder: Path) -> dict[str, int]:
    """Versions in the slots, and the current one."""
    return {path.name: whole(path).manifest.version for path in folder.iterdir() if path.name in ("a", "b", "current")}


def test_the_first_and_the_next_take_turns(tmp_path: Path) -> None:
    slots = Slots(tmp_path / "slots")
    assert slots.current is None
    seen: list[tuple[str | None, dict[str, int]]] = []
    for number in (1, 2, 3):
        slots.install(version(tmp_path, number), TRUST, passes)
        seen.append((slots.current, there(tmp_path / "slots")))
    assert seen == [
        ("a", {"a": 1, "current": 1}),
        ("b", {"a": 1, "b": 2, "current": 2}),
        ("a", {"a": 3, "b": 2, "current": 3}),
    ]
    whole(tmp_path / "slots" / "current", TRUST)  # its signature came with it


def refused(slots: Slots, source: Path, message: str, by: Callable[[Path], None] = passes) -> None:
    before = there(slots._folder)
    with pytest.raises(InputError, match=message):
        slots.install(source, TRUST, by)
    assert there(slots._folder)["current"] == before["current"]
    assert not [path for path in slots._folder.iterdir() if path.name.startswith(".")]


@pytest.fixture
def slots(tmp_path: Path) -> Slots:
    made = Slots(tmp_path / "slots")
    made.install(version(tmp_path, 5), TRUST, passes)
    return made


def test_nothing_older_is_taken_and_nothing_else_of_the_same_version(slots: Slots, tmp_path: Path) -> None:
    refused(slots, version(tmp_path, 4), "version 4 is older than 5, which was there before")
    refused(slots, version(tmp_path, 5, start_within_s=61.0), "is another bundle of version 5")
    refused(slots, version(tmp_path, 9, "brakes"), "is 'brakes', and 'uds' is what is installed here")
    slots.install(version(tmp_path, 5), TRUST, passes)  # the same once more
    slots.install(version(tmp_path, 9), TRUST, passes)
    refused(slots, version(tmp_path, 5), "version 5 is older than 9")


def test_where_the_floor_is_lost_what_is_current_is_the_floor(slots: Slots, tmp_path: Path) -> None:
    (tmp_path / "slots" / "floor.json").unlink()
    refused(slots, version(tmp_path, 4), "version 4 is older than 5")


def test_one_is_installed_at_a_time(slots: Slots, tmp_path: Path) -> None:
    """Two would use the same slot, and one lower the other's floor."""

    def meanwhile(_folder: Path) -> None:
        refused(Slots(tmp_path / "slots"), version(tmp_path, 9), "another bundle is being installed")

    slots.install(version(tmp_path, 6), TRUST, meanwhile)
    assert there(tmp_path / "slots")["current"] == 6


def test_everybody_may_read_what_is_installed_whatever_the_umask(tmp_path: Path) -> None:
    """The service is not root, who installs."""
    before = os.umask(0o077)
    try:
        Slots(tmp_path / "new" / "slots").install(version(tmp_path, 1), TRUST, passes)
    finally:
        os.umask(before)
    for path in [tmp_path / "new", tmp_path / "new" / "slots", *(tmp_path / "new" / "slots").rglob("*")]:
        if path.name != "lock":
            assert path.stat().st_mode & 0o777 == (0o755 if path.is_dir() else 0o644), path


def test_what_is_not_signed_or_damaged_is_not_taken(slots: Slots, tmp_path: Path) -> None:
    refused(slots, version(tmp_path, 6, signed=False), "signed by 0 trusted keys of 1")
    bad = version(tmp_path, 7)
    (bad / "ode.onnx").write_bytes(b"x")
    refused(slots, bad, "differ from the manifest")
    refused(slots, tmp_path / "nowhere", "not found")


def test_what_fails_its_trial_is_not_swapped_in(slots: Slots, tmp_path: Path) -> None:
    def fails(folder: Path) -> None:
        whole(folder, TRUST)  # whole, in its slot
        raise InputError("fails")

    refused(slots, version(tmp_path, 6), "fails", by=fails)
    slots.install(version(tmp_path, 6), TRUST, passes)  # the floor was not raised by it


def test_a_full_disk_leaves_the_current_one(slots: Slots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_file: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match=f"No space left on device: '{tmp_path}/slots/"):
            slots.install(version(tmp_path, 6), TRUST, passes)
    assert there(tmp_path / "slots")["current"] == 5
    slots.install(version(tmp_path, 6), TRUST, passes)


@pytest.mark.parametrize("step", [(os, "fsync"), (Path, "rename"), (Path, "replace")], ids=lambda step: step[1])
@pytest.mark.parametrize("after", range(14))
def test_power_may_fail_at_any_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: tuple[object, str], after: int
) -> None:
    """Whatever was done until then, the current bundle is whole, and the next attempt goes through."""
    made, count = Slots(tmp_path / "slots"), [0]
    made.install(version(tmp_path, 5), TRUST, passes)
    real = getattr(*step)

    class PowerCutError(BaseException):
        pass

    def cut(*arguments: object) -> object:
        if count[0] == after:
            raise PowerCutError
        count[0] += 1
        return real(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(*step, cut)
        with contextlib.suppress(PowerCutError):
            made.install(version(tmp_path, 6), TRUST, passes)
    assert whole(tmp_path / "slots" / "current", TRUST).manifest.version in (5, 6)
    made.install(version(tmp_path, 6), TRUST, passes)
    assert whole(tmp_path / "slots" / "current", TRUST).manifest.version == 6


@pytest.mark.parametrize("damage", [b"{", b'{"version":-1,"id":""}', b'{"version":9,"id":"","more":1}'])
def test_a_damaged_floor_lets_nothing_in(slots: Slots, tmp_path: Path, damage: bytes) -> None:
    (tmp_path / "slots" / "floor.json").write_bytes(damage)
    refused(slots, version(tmp_path, 6), "floor.json: cannot be read .*put it right by hand")


def test_a_link_that_leads_elsewhere_is_said(slots: Slots, tmp_path: Path) -> None:
    link = tmp_path / "slots" / "current"
    link.unlink()
    link.symlink_to("/etc")
    with pytest.raises(SlotError, match="leads to '/etc', not to a slot"):
        slots.install(version(tmp_path, 6), TRUST, passes)
    link.unlink()
    link.mkdir()
    with pytest.raises(SlotError, match="is no link to a slot"):
        _ = slots.current


def test_the_trial_computes_the_golden_vectors(tmp_path: Path) -> None:
    trial(version(tmp_path, 1))
    wrong = version(tmp_path, 2)
    golden = json.loads((wrong / "golden.json").read_bytes())
    golden["r"][3][0] += 1e6
    put(wrong, "golden.json", json.dumps(golden).encode())
    with pytest.raises(InputError, match=r"failed its trial .*: .*golden vector 3: t02.ode is off by"):
        trial(wrong)


def test_a_trial_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"its trial was not done after 0.05 s"):
        trial(version(tmp_path, 1), patience_s=0.05)


def test_the_command_installs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    into = ["--into", str(tmp_path / "slots")]
    source = str(version(tmp_path, 1))
    assert main(["install", source, *into, "--allow-unsigned"]) == 0
    assert "uds version 1, id " in capsys.readouterr().out
    with pytest.raises(InputError, match="give --keys, or --allow-unsigned for a trial; one of them"):
        main(["install", source, *into])
    with pytest.raises(SignatureError, match="no trusted key"):
        main(["install", source, *into, "--keys", str(tmp_path)])
    with pytest.raises(BundleError):
        main(["install", str(tmp_path / "none"), *into, "--allow-unsigned"])


def filled(folder: Path) -> Path:
    """Slots with versions 1 and 2, of which 2 is current."""
    slots = Slots(folder)
    for number in (1, 2):
        slots.install(version(folder.parent, number), TRUST, passes)
    return folder / CURRENT


def test_the_slot_that_was_current_before_stands_in(tmp_path: Path) -> None:
    current = filled(tmp_path / "slots")
    other = spare(current)
    assert other is not None
    assert whole(other, TRUST).manifest.version == 1
    assert spare(tmp_path / "slots" / "a") is None, "a folder that is no link to a slot has no spare one"


def test_what_never_stood_its_trial_does_not_stand_in(tmp_path: Path) -> None:
    current = filled(tmp_path / "slots")
    shutil.rmtree(current.parent / "a")
    shutil.copytree(version(tmp_path, 3), current.parent / "a")
    assert spare(current) is None
    shutil.rmtree(current.parent / "a")
    assert spare(current) is None


def test_where_the_floor_is_lost_nothing_stands_in(tmp_path: Path) -> None:
    current = filled(tmp_path / "slots")
    (current.parent / "floor.json").write_text("")
    with pytest.raises(SlotError, match="what may stand in is not known"):
        spare(current)


@pytest.mark.parametrize("damage", [1, 2])
def test_a_damaged_slot_is_refused_and_the_other_one_runs(tmp_path: Path, damage: int) -> None:
    current = filled(tmp_path / "slots")
    load = Loader(lambda: TRUST)
    assert load.or_spare(current)[1] == ""
    for slot in ("b", "a")[:damage]:
        file = current.parent / slot / "ode.onnx"
        raw = bytearray(file.read_bytes())
        raw[len(raw) // 2] ^= 1
        file.write_bytes(raw)
    bundle, why = load.or_spare(current)
    assert "current/ode.onnx: its bytes differ" in why
    assert (bundle is None) == (damage == 2)
    assert bundle is None or bundle.manifest.version == 1
    assert ("of the other slot" in why) == (damage == 2)


def test_without_its_key_no_slot_is_taken(tmp_path: Path) -> None:
    def gone() -> Signed:
        raise InputError("/etc/faultline/keys: no public key there")

    assert Loader(gone).or_spare(filled(tmp_path / "slots"))[0] is None
