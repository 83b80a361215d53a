"""`faultline` finds its commands, imports one of them, and turns whatever happens into a line and an exit code."""

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from faultline.service import cli
from faultline.service.cli import GROUP, dispatch, overview

ROOT = Path(__file__).parents[3]

COMMAND = '''"""{line}

More.
"""

from faultline.service.core.errors import InputError


def main(argv: list[str]) -> int:
{body}
'''


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path, for a package of commands."""
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "fakecommands").mkdir()
    (tmp_path / "fakecommands" / "__init__.py").touch()
    yield tmp_path / "fakecommands"
    for name in [name for name in sys.modules if name.partition(".")[0] == "fakecommands"]:
        del sys.modules[name]


def _command(package: Path, name: str, body: str) -> dict[str, EntryPoint]:
    (package / f"{name}.py").write_text(COMMAND.format(line=f"The {name} command.", body=f"    {body}"))
    return {name: EntryPoint(name, f"fakecommands.{name}:main", GROUP)}


def _declared() -> dict[str, EntryPoint]:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][GROUP]
    return {name: EntryPoint(name, value, GROUP) for name, value in table.items()}


def test_runs_the_command_with_the_rest_of_the_arguments(package: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands = _command(package, "say", "print(*argv); return 1")
    assert dispatch(["say", "a", "--b"], commands) == 1
    assert capsys.readouterr().out == "a --b\n"


def test_help_lists_every_command_without_importing_any(capsys: pytest.CaptureFixture[str]) -> None:
    script = (
        "import sys; from tests_commands import commands; from faultline.service.cli import dispatch\n"
        "code = dispatch(['--help'], commands)\n"
        "heavy = {'numpy', 'can', 'cantools', 'scipy', 'msgspec', 'faultline.analysis', 'faultline.testbench'}\n"
        "heavy &= set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else code)"
    )
    rows = {name: entry.value for name, entry in _declared().items()}
    setup = (
        "import sys, types; from importlib.metadata import EntryPoint\n"
        "module = types.ModuleType('tests_commands'); sys.modules['tests_commands'] = module\n"
        f"module.commands = {{n: EntryPoint(n, v, {GROUP!r}) for n, v in {rows!r}.items()}}\n"
    )
    done = subprocess.run([sys.executable, "-c", setup + script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in rows:
        assert f"\n  {name:<12}" in done.stdout
    vehicle, offline = done.stdout.index("On the vehicle:"), done.stdout.index("Offline:")
    assert vehicle < done.stdout.index("\n  watch") < offline < done.stdout.index("\n  ingest")


def test_the_line_in_the_help_is_the_docstrings_first() -> None:
    from faultline.service import watch

    assert (watch.__doc__ or "").partition("\n")[0] in overview(_declared())


def test_a_command_left_out_of_the_installation_is_said_so(package: Path) -> None:
    text = overview({"gone": EntryPoint("gone", "faultline.service.gone.nowhere:main", GROUP)})
    assert "gone        (not part of this installation)" in text


def test_a_packages_docstring_serves_too() -> None:
    assert "Logs and recordings" in overview({"logs": EntryPoint("logs", "faultline.service.logs:main", GROUP)})


def test_no_command_is_wrong_use(capsys: pytest.CaptureFixture[str]) -> None:
    assert dispatch([], {}) == 2
    assert "usage: faultline" in capsys.readouterr().err


@pytest.mark.parametrize(("given", "words"), [("wacth", "did you mean `faultline watch`?"), ("zzz", "--help` lists")])
def test_an_unknown_command_is_wrong_use(given: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert dispatch([given], _declared()) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"faultline: error: no command '{given}'")
    assert words in error


def test_bad_input_is_one_line_and_two(package: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands = _command(package, "fail", "raise InputError('x.log: is empty; give another')")
    assert dispatch(["fail"], commands) == 2
    assert capsys.readouterr().err == "faultline fail: error: x.log: is empty; give another\n"


def test_an_interrupt_is_not_a_traceback(package: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands = _command(package, "stop", "raise KeyboardInterrupt")
    assert dispatch(["stop"], commands) == 130
    assert capsys.readouterr().err == "faultline stop: interrupted\n"


def test_a_missing_extra_is_named(
    package: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "requires", lambda _: ["numpy>=2", 'scipy>=1.14; extra == "design"'])
    commands = _command(package, "fit", "raise ModuleNotFoundError(name='scipy.signal')")
    assert dispatch(["fit"], commands) == 2
    assert "needs scipy.signal; pip install 'faultline-diagnosis[design]'" in capsys.readouterr().err
    commands = _command(package, "rigged", "raise ModuleNotFoundError(name='faultline.testbench')")
    assert dispatch(["rigged"], commands) == 2
    assert "this installation of faultline is without it" in capsys.readouterr().err


def test_a_module_that_nobody_promised_is_a_bug(
    package: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "requires", lambda _: ["numpy>=2"])
    commands = _command(package, "broken", "raise ModuleNotFoundError(name='numpyy')")
    assert dispatch(["broken"], commands) == 3
    assert (
        capsys.readouterr().err.splitlines()[-1].startswith("faultline broken: internal error: ModuleNotFoundError: ")
    )


@pytest.mark.parametrize(
    "crash", ["assert argv", "raise ValueError('two\\nlines')", "raise MemoryError", "raise OSError(9, 'Bad file')"]
)
def test_a_crash_is_no_answer(package: Path, capsys: pytest.CaptureFixture[str], crash: str) -> None:
    """1 would mean that a fault was found."""
    assert dispatch(["crash"], _command(package, "crash", crash)) == 3
    *before, last = capsys.readouterr().err.splitlines()
    assert before[0] == "Traceback (most recent call last):"
    assert last.startswith("faultline crash: internal error: ")
    assert last.endswith("; please report it with the lines above")


def test_wrong_use_and_help_keep_argparses_codes(package: Path) -> None:
    body = "import argparse; argparse.ArgumentParser('x').parse_args(argv)"
    commands = _command(package, "parsed", body)
    assert dispatch(["parsed", "--zzz"], commands) == 2
    assert dispatch(["parsed", "--help"], commands) == 0


@pytest.mark.parametrize(
    ("body", "line"),
    [
        (
            "raise OSError(28, 'No space left on device', 'a.csv')",
            "a.csv: No space left on device; free some space at /",
        ),
        ("raise PermissionError(13, 'Permission denied', 'b.csv')", "b.csv: Permission denied; give another path"),
        ("open('/nowhere/x')", "/nowhere/x: No such file or directory; give another path"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_line(
    package: Path, capsys: pytest.CaptureFixture[str], body: str, line: str
) -> None:
    assert dispatch(["keep"], _command(package, "keep", body)) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"faultline keep: error: {line}")
    assert error.count("\n") == 1


def _run(package: Path, body: str, redirection: str, *, unbuffered: bool) -> subprocess.CompletedProcess[str]:
    """A process of its own, as what the interpreter does at its end counts."""
    _command(package, "talk", body)
    script = (
        "import sys; from importlib.metadata import EntryPoint; from faultline.service.cli import dispatch\n"
        "sys.exit(dispatch(sys.argv[1:], {'talk': EntryPoint('talk', 'fakecommands.talk:main', 'g')}))"
    )
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'src'}:{package.parent}", "PYTHONUNBUFFERED": "1" * unbuffered}
    shell = f'exec {sys.executable} -c "$1" talk {redirection}'
    words = ["sh", "-c", shell, "sh", script]
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("unbuffered", [False, True])
@pytest.mark.parametrize("body", ["print('x'); return 0", "print('x' * 100_000); return 1", "print(1); sys.exit(0)"])
def test_an_output_that_cannot_be_written_is_no_answer(package: Path, body: str, unbuffered: bool) -> None:
    done = _run(package, f"import sys; {body}", "> /dev/full", unbuffered=unbuffered)
    assert (done.returncode, done.stdout) == (3, "")
    why = "the output cannot be written: No space left on device"
    assert done.stderr == f"faultline talk: error: {why}; free some space, or send it elsewhere\n"


@pytest.mark.parametrize("unbuffered", [False, True])
@pytest.mark.parametrize("redirection", ["2> /dev/full", "2>&-"])
def test_messages_that_cannot_be_written_change_no_code(package: Path, redirection: str, unbuffered: bool) -> None:
    done = _run(package, "print('x'); raise InputError('y')", redirection, unbuffered=unbuffered)
    assert (done.returncode, done.stdout, done.stderr) == (2, "x\n", "")
    done = _run(package, "raise ValueError", redirection, unbuffered=unbuffered)
    assert done.returncode == 3


def test_a_closed_output_is_written_nowhere(package: Path, tmp_path: Path) -> None:
    body = f"file = open({str(tmp_path / 'x')!r}, 'w'); print('y'); file.write('x'); return 1"
    assert _run(package, body, ">&-", unbuffered=False).returncode == 1
    assert (tmp_path / "x").read_text() == "x"


def test_version_without_installation(capsys: pytest.CaptureFixture[str]) -> None:
    assert dispatch(["--version"], {}) == 0
    assert capsys.readouterr().out.startswith("faultline ")


def test_a_closed_pipe_ends_quietly(package: Path) -> None:
    commands = _command(package, "talk", "[print(k) for k in range(100_000)]; return 0")
    value = commands["talk"].value
    script = (
        "import sys; from importlib.metadata import EntryPoint; from faultline.service.cli import dispatch\n"
        f"sys.exit(dispatch(['talk'], {{'talk': EntryPoint('talk', {value!r}, 'g')}}))"
    )
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'src'}:{package.parent}"}
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as talker:
        assert talker.stdout is not None
        assert talker.stderr is not None
        talker.stdout.readline()
        talker.stdout.close()
        assert talker.stderr.read() == b""
        assert talker.wait() == 141
