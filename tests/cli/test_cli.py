"""The command line as a whole: names, help, exit codes, what is loaded when."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import import_module

import pytest
from typer.testing import CliRunner

import vibroscreen
from vibroscreen.cli import COMMANDS, ELSEWHERE, app


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """`python -m vibroscreen` in a process of its own."""
    command = [sys.executable, "-m", "vibroscreen", *arguments]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def test_help_names_every_command() -> None:
    """By its line; the same with -h, and where nothing is asked."""
    told = run("--help")
    assert told.returncode == 0
    for name, text in COMMANDS.items():
        assert f"  {name} " in told.stdout
        assert " ".join(text.split()) in " ".join(told.stdout.split())
    assert run("-h").stdout == told.stdout
    nothing = run()
    assert nothing.returncode == 2
    assert nothing.stdout + nothing.stderr == told.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command(name: str) -> None:
    """It begins with the line of the table, and ends with examples of the command."""
    module = import_module(ELSEWHERE.get(name, f"vibroscreen.cli.{name}"))
    assert (module.command.__doc__ or "").splitlines()[0] == COMMANDS[name]
    told = CliRunner().invoke(app, [name, "--help"]).output
    assert told.startswith(f"Usage: {app.info.name or 'root'} {name} ")
    examples = told.partition("Examples:\n")[2].split("\n")
    assert [line.strip() for line in examples if line] == module.EXAMPLES.splitlines()
    assert all(line.startswith(f"vibroscreen {name} ") for line in module.EXAMPLES.splitlines())


def test_help_loads_no_engine() -> None:
    """Neither numbers nor tables nor pictures are imported for it."""
    code = (
        "import sys; from typer.testing import CliRunner; from vibroscreen.cli import app; "
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0; "
        "print(sorted({'numpy', 'pandas', 'matplotlib', 'rich', 'numba'} & set(sys.modules)))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment
    )
    assert done.stdout.strip() == "[]", done.stderr


def test_version() -> None:
    """That of the package."""
    assert run("--version").stdout == f"vibroscreen {vibroscreen.__version__}\n"


def test_usage() -> None:
    """What is no command or option ends with 2 and says what is near."""
    wrong = run("slove", "screen.toml")
    assert wrong.returncode == 2
    assert "No such command 'slove'. Did you mean 'solve'?" in wrong.stderr
    wrong = run("solve")
    assert wrong.returncode == 2
    assert "Missing argument" in wrong.stderr


def test_a_command_without_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is missing, and what brings it."""
    monkeypatch.delitem(sys.modules, "vibroscreen_fmu.build", raising=False)
    monkeypatch.setitem(sys.modules, "fmpy", None)
    done = CliRunner().invoke(app, ["build", "screen.toml"])
    assert done.exit_code == 1
    assert done.stderr == (
        "vibroscreen build needs fmpy, which is not installed: pip install 'vibroscreen[fmu]'\n"
    )


def test_public_names() -> None:
    """All of the package are there, though none is loaded before it is asked for."""
    for name in vibroscreen.__all__:
        assert getattr(vibroscreen, name).__name__ == name
        assert name in dir(vibroscreen)
    assert vibroscreen.sweep.solve_steady_many is vibroscreen.solve_steady_many
    with pytest.raises(AttributeError, match="has no attribute 'Screan'"):
        vibroscreen.Screan  # noqa: B018


def test_completion(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shell is told the commands that begin so, and the options of one."""
    for words, place, told in (
        ("vibroscreen s", "1", {"solve", "simulate"}),
        ("vibroscreen solve --p", "2", {"--plot"}),
    ):
        monkeypatch.setenv("_VIBROSCREEN_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", place)
        assert set(run().stdout.split()) >= told
        assert all(word.startswith(words.split()[-1]) for word in run().stdout.split())
