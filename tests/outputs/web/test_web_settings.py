"""What is taken as settings, tokens and names, and what is refused with its remedy."""

import os
from pathlib import Path

import pytest

from faultline.service import strict
from faultline.service.core.errors import InputError
from faultline.service.web.limits import host_of, hosts_of
from faultline.service.web.settings import Settings, Tcp, Unix, load_settings
from faultline.service.web.tokens import Tokens, bearer, find_tokens, load_tokens


class TestHosts:
    @pytest.mark.parametrize(
        ("header", "host"),
        [
            *(("localhost", "localhost"), ("LOCALHOST:8080", "localhost"), ("127.0.0.1:1", "127.0.0.1")),
            *(
                ("[::1]:80", "[::1]"),
                ("", ""),
                ("a:b:c", ""),
                ("localhost:99999999", ""),
                ("localhost@evil", "localhost@evil"),
            ),
        ],
    )
    def test_the_name_in_a_header(self, header: str, host: str) -> None:
        assert host_of(header) == host

    def test_those_of_a_server(self) -> None:
        assert hosts_of(["127.0.0.7"]) == {"localhost", "127.0.0.1", "[::1]", "127.0.0.7"}
        assert Settings(control="/c", events="/e", listen="unix:/x").hosts is None
        assert Settings(control="/c", events="/e", listen="10.0.0.1:80", allow_remote=True).hosts is None


class TestSettings:
    GOOD = 'control = "/c"\nevents = "/e"\nlisten = "[::1]:8080"\ntoken_file = "/t"\n'

    def write(self, folder: Path, text: str) -> Path:
        path = folder / "http.toml"
        path.write_text(text)
        return path

    def test_a_whole_file(self, tmp_path: Path) -> None:
        settings = load_settings(self.write(tmp_path, self.GOOD))
        assert settings == Settings(
            control="/c",
            events="/e",
            listen="[::1]:8080",
            token_file="/t",  # noqa: S106
        )

    def test_the_shipped_file_is_taken(self, tmp_path: Path) -> None:
        text = (Path(strict.__file__).parent / "vehicle" / "serve.toml").read_text()
        assert load_settings(self.write(tmp_path, text)).place == Tcp("127.0.0.1", 8080)
        every = text.replace("# token_file", "token_file").replace("# allow_remote", "allow_remote")
        assert load_settings(self.write(tmp_path, every)).allow_remote

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (
                "listen =",
                "lisen =",
                r":3: lisen: there is no such key \(did you mean `listen`\?\); those are control, events",
            ),
            ('"/c"', '"c"', r":1: control: this text is not accepted; give the daemon's control socket, as /"),
            ('control = "/c"\n', "", r":1: `control` is missing; give the daemon's control socket, as /"),
            ('"[::1]:8080"', "8080", r":3: listen: Expected `str`, got `int`; give 127.0.0.1:8080, or unix:PATH"),
            ('"[::1]:8080"', '"0.0.0.0:80"', r":3: listen: 0.0.0.0:80 can be reached .*allow_remote = true"),
            ('"[::1]:8080"', '"vehicle:80"', r":3: listen: 'vehicle:80' is no address"),
            ('"[::1]:8080"', '"127.0.0.1:99999"', r":3: listen: .*no port above"),
            ('"[::1]:8080"', '"unix:here"', r":3: listen: unix:here: give the whole path"),
            ('"[::1]:8080"', '"::1:8080"', r":3: listen: '::1:8080' is no address"),
            ("control", "control control", r"not TOML"),
        ],
    )
    def test_errors_name_the_line(self, tmp_path: Path, old: str, new: str, message: str) -> None:
        path = self.write(tmp_path, self.GOOD.replace(old, new))
        with pytest.raises(InputError, match=message) as caught:
            load_settings(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)

    def test_no_file_is_an_error_too(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="cannot be read"):
            load_settings(tmp_path / "none")

    @pytest.mark.parametrize("listen", ["127.0.0.1:1", "127.8.8.8:1", "localhost:1", "[::1]:1", "unix:/run/x"])
    def test_this_machine_may_be_listened_on(self, listen: str) -> None:
        assert Settings(control="/c", events="/e", listen=listen).place in (
            *(Tcp("127.0.0.1", 1), Tcp("127.8.8.8", 1), Tcp("::1", 1)),
            Unix(Path("/run/x")),
        )

    @pytest.mark.parametrize("listen", ["0.0.0.0:1", "10.1.2.3:1", "[::]:1", "[2001:db8::1]:1", "[::ffff:8.8.8.8]:1"])
    def test_others_may_not(self, listen: str) -> None:
        with pytest.raises(InputError, match=r"other machines|no address"):
            _ = Settings(control="/c", events="/e", listen=listen).place


class TestTokens:
    def file(self, folder: Path, text: str, mode: int = 0o600) -> Path:
        path = folder / "tokens"
        path.write_text(text)
        path.chmod(mode)
        return path

    def test_one_a_line(self, tmp_path: Path) -> None:
        tokens = load_tokens(self.file(tmp_path, f"# workshop\n{'a' * 32}\n\n  {'b' * 40}== \n"))
        assert tokens.known("a" * 32)
        assert tokens.known("b" * 40 + "==")
        assert not any(tokens.known(each) for each in ("", "a" * 31, "a" * 33, "# workshop", "b" * 40))

    @pytest.mark.parametrize("mode", [0o604, 0o602, 0o644, 0o666])
    def test_others_must_not_read_it(self, tmp_path: Path, mode: int) -> None:
        with pytest.raises(InputError, match=r"others may read or write it; `chmod o= .*tokens`"):
            load_tokens(self.file(tmp_path, "a" * 32, mode))

    @pytest.mark.parametrize("mode", [0o400, 0o440, 0o660])
    def test_the_group_may(self, tmp_path: Path, mode: int) -> None:
        assert load_tokens(self.file(tmp_path, "a" * 32, mode))

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "no token"),
            ("# only this\n", "no token"),
            ("\n" + "a" * 31, ":2: a token needs 32"),
            ("a" * 32 + "\n" + "ü" * 32, ":2: a token has letters"),
            ("a" * 32 + " " + "b" * 32, ":1: a token has letters"),
            ("a" * 70_000, "more than 64 KiB"),
        ],
    )
    def test_what_is_no_token_is_not_repeated(self, tmp_path: Path, text: str, message: str) -> None:
        with pytest.raises(InputError, match=message) as caught:
            load_tokens(self.file(tmp_path, text))
        assert "aaaa" not in str(caught.value)

    def test_what_is_no_file(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="cannot be read"):
            load_tokens(tmp_path / "none")
        os.mkfifo(tmp_path / "fifo")
        descriptor = os.open(tmp_path / "fifo", os.O_RDWR)
        try:
            with pytest.raises(InputError, match="no regular file"):
                load_tokens(tmp_path / "fifo")
        finally:
            os.close(descriptor)

    def test_the_credential_that_systemd_hands_over(self, tmp_path: Path) -> None:
        environment = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
        assert not find_tokens(None, environment)
        self.file(tmp_path, "a" * 32, 0o400).rename(tmp_path / "http-tokens")
        assert find_tokens(None, environment).known("a" * 32)
        assert not find_tokens(None, {})
        other = self.file(tmp_path, "b" * 32)
        assert not find_tokens(str(other), environment).known("a" * 32)

    @pytest.mark.parametrize(
        ("header", "token"),
        [
            *(("Bearer abc", "abc"), ("bearer  abc ", "abc"), ("BEARER a-._~+/=", "a-._~+/=")),
            *(
                ("", None),
                ("Bearer", None),
                ("Bearer ", None),
                ("Basic abc", None),
                ("Bearer a b", None),
                ("abc", None),
            ),
        ],
    )
    def test_the_header(self, header: str, token: str | None) -> None:
        assert bearer(header) == token

    def test_none_are_none(self) -> None:
        assert not Tokens()
        assert not Tokens().known("")
