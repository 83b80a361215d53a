"""Signatures: made and verified, by our own words and by minisign's; and every way in which they do not hold."""

import base64
import shutil
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, NoEncryption, PrivateFormat
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.bundle.command import main
from faultline.service.bundle.files import BundleError
from faultline.service.bundle.load import load_bundle
from faultline.service.bundle.signing import (
    SignatureError,
    Signed,
    load_keys,
    load_private,
    load_public,
    public_of,
    public_text,
    sign,
    verify,
)
from faultline.service.core.errors import InputError

GOLDEN = Path(__file__).parents[2] / "golden" / "bundle"
KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
OTHER = Ed25519PrivateKey.from_private_bytes(bytes(range(1, 33)))

# Of minisign's own documentation and source (github's jedisct1/minisign, tests): a key pair and a pure signature.
PUBLIC = """untrusted comment: minisign public key E7620F1842B4E81F
RWQf6LRCGA9i53mlYecO4IzT51TGPpvWucNSCh1CBM0QTaLn73Y7GFO3
"""
SIGNED = """untrusted comment: signature from minisign secret key
RWQf6LRCGA9i59SLOFxz6NxvASXDJeRtuZykwQepbDEGt87ig1BNpWaVWuNrm73YiIiJbq71Wi+dP9eKL8OC351vwIasSSbXxwA=
trusted comment: timestamp:1555779966\tfile:test
QtKMXWyYcwdpZAlPF7tE2ENJkRd1ujvKjlj1m9RtHTBnZPa5WKU5uWRs5GoP5M/VqE81QFuMKI5k/SfNQUaOAA==
"""


def pem(folder: Path, key: Ed25519PrivateKey = KEY, password: bytes | None = None) -> Path:
    path = folder / "key.pem"
    encryption = NoEncryption() if password is None else BestAvailableEncryption(password)
    path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption))
    return path


def keys(folder: Path, *privates: Ed25519PrivateKey) -> Path:
    folder.mkdir(exist_ok=True)
    for k, private in enumerate(privates):
        (folder / f"key-{k}.pub").write_text(public_text(public_of(private)))
    return folder


def signed(folder: Path, *privates: Ed25519PrivateKey) -> Path:
    """The golden bundle, signed by these."""
    bundle = Path(shutil.copytree(GOLDEN, folder / "bundle"))
    for private in privates:
        assert main(["sign", str(bundle), "--key", str(pem(folder, private))]) == 0
    return bundle


def test_minisigns_own_vector_verifies(tmp_path: Path) -> None:
    (tmp_path / "k.pub").write_text(PUBLIC)
    assert load_public(tmp_path / "k.pub").label == "E7620F1842B4E81F"
    assert verify(b"test", SIGNED.encode(), "s", load_keys(tmp_path)).name == "k.pub"
    with pytest.raises(SignatureError, match="is not of these bytes"):
        verify(b"Test", SIGNED.encode(), "s", load_keys(tmp_path))


def test_a_signed_bundle_is_taken_and_its_signature_is_no_unlisted_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bundle = signed(tmp_path, KEY)
    load_bundle(bundle)
    load_bundle(bundle, Signed(load_keys(keys(tmp_path / "keys", KEY))))
    capsys.readouterr()
    assert main(["verify", str(bundle), "--keys", str(tmp_path / "keys")]) == 0
    assert "signed by 1 trusted key at least" in capsys.readouterr().out
    assert main(["verify", str(bundle)]) == 0
    assert "nobody was asked who signed it" in capsys.readouterr().out


def test_so_many_different_keys_must_have_signed(tmp_path: Path) -> None:
    bundle, trusted = signed(tmp_path, KEY), load_keys(keys(tmp_path / "keys", KEY, OTHER))
    first, *_ = bundle.glob("*.minisig")
    (bundle / "manifest.0000000000000000.minisig").write_text(first.read_text())  # the same once more
    with pytest.raises(SignatureError, match="signed by 1 trusted keys of 2 that are needed"):
        load_bundle(bundle, Signed(trusted, 2))
    assert main(["sign", str(bundle), "--key", str(pem(tmp_path, OTHER))]) == 0
    load_bundle(bundle, Signed(trusted, 2))


def test_one_key_under_two_ids_is_one_key(tmp_path: Path) -> None:
    """The id is only what a file says."""
    bundle = signed(tmp_path, KEY)
    (path,) = bundle.glob("*.minisig")
    key = public_of(KEY)
    other = key._replace(id=bytes(reversed(key.id)))
    lines = path.read_text().splitlines()
    raw = base64.b64decode(lines[1])
    lines[1] = base64.b64encode(raw[:2] + other.id + raw[10:]).decode()
    (bundle / f"manifest.{other.label}.minisig").write_text("\n".join(lines) + "\n")
    with pytest.raises(SignatureError, match="signed by 1 trusted key"):
        load_bundle(bundle, Signed({key.id: key, other.id: other}, required=2))


def test_what_is_not_signed_or_by_others_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    bundle, trusted = signed(tmp_path, OTHER), Signed(load_keys(keys(tmp_path / "keys", KEY)))
    (bundle / "manifest.sha256").write_text("nonsense")
    with pytest.raises(SignatureError, match=r"signed by 0 trusted keys of 1 .*1 signatures are there"):
        load_bundle(bundle, trusted)


def test_a_bundle_that_was_changed_after_signing_is_refused(tmp_path: Path) -> None:
    bundle, trusted = signed(tmp_path, KEY), Signed(load_keys(keys(tmp_path / "keys", KEY)))
    raw = (bundle / "manifest.json").read_bytes()
    (bundle / "manifest.json").write_bytes(raw.replace(b'"version": 0', b'"version": 9'))
    with pytest.raises(SignatureError, match="is not of these bytes: the bundle was changed"):
        load_bundle(bundle, trusted)
    (bundle / "manifest.json").write_bytes(raw)
    (bundle / "ode.onnx").write_bytes(b"x" + (bundle / "ode.onnx").read_bytes()[1:])
    with pytest.raises(BundleError, match="differ from the manifest"):
        load_bundle(bundle, trusted)


@given(st.data())
def test_no_damage_of_a_signature_holds(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    folder = tmp_path_factory.mktemp("s")
    trusted = load_keys(keys(folder, KEY))
    text = bytearray(sign(b"content", KEY, "a comment").encode())
    place = data.draw(st.integers(text.index(b"\n") + 1, len(text) - 1))  # the first line is trusted by nobody
    before = text[place]
    text[place] = data.draw(st.integers(0, 255).filter(lambda value: value != before))
    message = ""
    try:
        verify(b"content", bytes(text), "s", trusted)
    except SignatureError as error:
        message = str(error)
    # A last newline more or less, or as another line's end, changes no word of it.
    assert message or text.decode(errors="replace").splitlines() == sign(b"content", KEY, "a comment").splitlines()
    assert "\n" not in message


def test_keys_are_read_from_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = pem(tmp_path, KEY, b"secret")
    assert load_private(path, b"secret").private_bytes_raw() == KEY.private_bytes_raw()
    for password, message in ((None, "is encrypted; give its password"), (b"wrong", "or the password is wrong")):
        with pytest.raises(SignatureError, match=message):
            load_private(path, password)
    with pytest.raises(SignatureError, match="is not encrypted; leave the password out"):
        load_private(pem(tmp_path), b"secret")
    assert main(["public", str(path), "--out", str(tmp_path / "keys" / "k.pub")]) == 0
    assert load_keys(tmp_path / "keys") == {public_of(KEY).id: public_of(KEY, "k.pub")}


def test_the_password_is_taken_from_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAULTLINE_KEY_PASSWORD", "secret")
    assert main(["public", str(pem(tmp_path, KEY, b"secret")), "--out", str(tmp_path / "k.pub")]) == 0


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("k.pub", b"", "not a public key of minisign's"),
        ("k.pub", b"\xff\xfe", "no text; give a public key"),
        ("k.pub", b"untrusted comment: x\nRWQ\n", "line 2: not base64"),
        ("k.pub", b"untrusted comment: x\nAAAA\n", "line 2: not an ed25519 public key"),
        ("k.pub", b"x" * 5000, "more than 4096 bytes"),
        ("none", b"", "no trusted key"),
    ],
)
def test_what_is_no_key_is_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SignatureError, match=message):
        load_keys(tmp_path)


def test_two_keys_of_one_id_are_refused(tmp_path: Path) -> None:
    mine = public_of(KEY)
    (tmp_path / "a.pub").write_text(public_text(mine))
    (tmp_path / "b.pub").write_text(public_text(public_of(OTHER)._replace(id=mine.id)))
    with pytest.raises(SignatureError, match=r"another key than a\.pub with the same id"):
        load_keys(tmp_path)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["sign", "{bundle}", "--key", "{dir}/none.pem"], "cannot be read: No such file or directory; openssl genpkey"),
        (["sign", "{bundle}", "--key", "{bundle}/uds.dbc"], "uds.dbc: (more than|no private key in PEM)"),
        (["sign", "{bundle}", "--key", "{dir}/key.pem", "--comment", "a\nb"], "--comment: is one line"),
        (["verify", "{bundle}", "--keys", "{dir}/none"], "none: no trusted key"),
        (["verify", "{bundle}", "--keys", "{dir}/keys", "--signatures", "0"], "--signatures 0: at least 1"),
    ],
)
def test_what_cannot_be_done_is_said(tmp_path: Path, words: list[str], message: str) -> None:
    bundle = Path(shutil.copytree(GOLDEN, tmp_path / "bundle"))
    pem(tmp_path)
    keys(tmp_path / "keys", KEY)
    with pytest.raises(InputError, match=message):
        main([word.format(bundle=bundle, dir=tmp_path) for word in words])
    assert not [*bundle.glob("*.minisig")]
