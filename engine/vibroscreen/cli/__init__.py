"""The command `vibroscreen`: what a plant engineer types.

A command is a line of COMMANDS and a module with a function `command`, whose docstring is its help
and whose parameters are its arguments; EXAMPLES stand below them. The module is imported when the
command is called, so that help is told at once. Commands print what they found with `terminal` and
raise what is wrong: errors that a user can mend are told here, without a traceback.

Exit codes: 0; 1 an error that the user can mend; 2 a command line that is none; 3 a result with
alarms where --strict asks for that.
"""

from __future__ import annotations

import inspect
import warnings
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import vibroscreen
from vibroscreen.errors import ConfigError, InputError

__all__ = ["COMMANDS", "app", "main"]

# What help says of a command: the first line of its docstring. Modules lie in this package unless
# they are named; those of packages that stand on this one are known by name only.
COMMANDS = {
    "new": "Write the file of a screen: asks, or takes a sieve analysis.",
    "check": "Tell what is wrong or unusual about a screen and its duty.",
    "solve": "Print the steady state of a screen under its duty.",
    "simulate": "Run a screen through a series of feeds and motions in time.",
    "replay": "Run a screen through a plant's data, beside what was measured.",
    "build": "Build the FMU of a screen, validate it and run two steps.",
    "report": "Write what a screen does as one file to hand on: HTML or PDF.",
    "circuit": "Print the steady state of a circuit of crushers and screens.",
    "study": "Find the design of a circuit that needs the least energy.",
    "reconcile": "Make the streams of a survey balance, tell gross errors.",
    "design": "Search for the best design of a screen or a circuit.",
    "size": "Choose the standard size of a screen for a duty.",
    "calibrate": "Fit numbers of a screen to a survey and write it with them.",
    "explore": "Write a page with the engine inside, and open it.",
}
ELSEWHERE = {"build": "vibroscreen_fmu.build"}
# What `pip install 'vibroscreen[...]'` brings for a command.
EXTRA = {
    "build": "fmu",
    "design": "study",
    "explore": "explore",
    "replay": "replay",
    "study": "study",
}
# What a user can mend; all else is a mistake of ours and keeps its traceback.
MENDABLE = (ConfigError, InputError, ImportError, OSError, MemoryError)


class _Commands(TyperGroup):
    """Commands by name; the module of one is loaded when it is called or asked for its help."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, _, rest = super().resolve_command(ctx, args)
        assert name is not None
        return name, loaded(name), rest

    def invoke(self, ctx: Any) -> Any:
        """Run a command; what a user can mend is told without a traceback."""
        with warnings.catch_warnings():
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = _tell_warning
            try:
                return super().invoke(ctx)
            except BrokenPipeError:  # who read has seen enough
                raise
            except MENDABLE as error:
                from vibroscreen.cli.terminal import tell_error

                tell_error(error)
                raise typer.Exit(code=1) from None


def loaded(name: str) -> Any:
    """The command of that name as typer runs it."""
    try:
        module = import_module(ELSEWHERE.get(name, f"{__name__}.{name}"))
    except ModuleNotFoundError as error:
        if name not in EXTRA or str(error.name).startswith("vibroscreen."):
            raise
        raise ImportError(
            f"vibroscreen {name} needs {error.name}, which is not installed: "
            f"pip install 'vibroscreen[{EXTRA[name]}]'"
        ) from None
    examples = getattr(module, "EXAMPLES", "")
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    epilog = examples and f"\b\nExamples:\n{examples}"
    app.command(name, help=inspect.getdoc(module.command), epilog=epilog)(module.command)
    return typer.main.get_command(app)


def _tell_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """What `warnings` calls to show one."""
    from vibroscreen.cli.terminal import tell

    tell(f"warning: {message}", "yellow")


def _print_version(asked: bool) -> None:
    if asked:
        print(f"vibroscreen {vibroscreen.__version__}")
        raise typer.Exit


def _start(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print it and end."),
    ] = False,
) -> None:
    """A vibrating screen: what it does with a feed, how well it fits its duty.

    Begin with `vibroscreen new screen.toml`, which writes the file that says what a screen is.
    """


app = typer.Typer(
    cls=_Commands,
    callback=_start,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _name, _text in COMMANDS.items():
    app.command(_name, help=_text)(lambda: None)


def main() -> None:
    """Run the command line."""
    app(prog_name="vibroscreen")
