"""The commands put together, and the way from an exception to one line and an exit code."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from types import FrameType
from typing import Annotated, Any

import typer
from typer.main import get_command

from tridentify.cli import terminal
from tridentify.cli.codes import BAD_INPUT, DONE, FAULT, INTERRUPTED, NO_ANSWER
from tridentify.cli.spread_groups import with_groups
from tridentify.errors import ConvergenceError, IdentifiabilityError, TridentifyError
from tridentify.writing.interruption import on_signals
from tridentify.writing.views import unseen

EXIT_CODES = (
    "Exit codes: 0 done; 1 the data do not allow an answer; 2 bad input or usage; 70 a fault of "
    "this program; 130 interrupted. Results go to standard output, progress and errors to "
    "standard error."
)

COMMANDS = {
    "advise": "advise_command.advise",
    "manoeuvres": "manoeuvres_command.manoeuvres",
    "identify": "identify_command.identify",
    "select": "select_command.select",
    "physical": "physical_command.physical",
    "channels": "channels_command.channels",
    "demo": "demo_command.demo",
    "stream": "stream_command.stream",
    "app": "app_command.workbench",
    "study": "study_command.study",
    "fleet": "fleet_command.fleet",
    "excite": "excite_command.excite",
    "export": "export_command.export",
    "validate": "validate_command.validate",
    "simulate": "simulate_command.simulate_file",
    "warm": "warm_command.warm",
    "compare": "compare_command.compare_models",
}
"""Where each is, by module and function: only what is asked for is loaded."""


def _show_version(asked: bool) -> None:
    if asked:
        from tridentify import __version__

        terminal.show(f"{terminal.PROGRAM} {__version__}")
        raise typer.Exit()


def start(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Say which version."),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error, with any command.")
    ] = False,
) -> None:
    """Physical coefficients of continuous-time models from sampled, noisy records."""
    if context.invoked_subcommand is None:
        terminal.show(context.get_help())
        raise typer.Exit(BAD_INPUT)


def needed(arguments: Sequence[str]) -> tuple[str, ...]:
    """Names of the commands that have to be loaded; all where they are listed.

    Examples
    --------
    >>> needed(["channels", "flight.csv"]), needed(["--version"]), len(needed(["--help"])) > 10
    (('channels',), (), True)
    """
    first = next((one for one in arguments if one != "--debug"), "")
    if first in COMMANDS:
        return (first,)
    return () if first == "--version" else tuple(COMMANDS)


@cache
def program(names: tuple[str, ...] = tuple(COMMANDS)) -> typer.Typer:
    """The program with some of its commands."""
    made = typer.Typer(
        name=terminal.PROGRAM,
        help="Physical coefficients of continuous-time models from sampled, noisy records.",
        epilog=EXIT_CODES,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    made.callback(invoke_without_command=True)(start)
    for name in names:
        module, function = COMMANDS[name].split(".")
        command = getattr(import_module(f"tridentify.cli.{module}"), function)
        made.command(name)(with_groups(command))
    return made


def run(arguments: Sequence[str]) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str
        What stands after the name of the program.

    Returns
    -------
    int
        As `tridentify.cli.main`.

    Examples
    --------
    >>> run(["--version"])
    tridentify ...
    0
    """
    given = list(arguments)
    options = given[: given.index("--")] if "--" in given else given
    debug = "--debug" in options
    if debug:
        given.remove("--debug")
    termination = on_signals(("SIGTERM", "SIGHUP"), _interrupt, _kills)
    with terminal.patient_streams(), termination, unseen():
        try:
            terminal.check_output()
            command = _command(needed(given))
            code = command.main(given, prog_name=terminal.PROGRAM, standalone_mode=False)
            if code == INTERRUPTED:  # newer versions of typer turn an interrupt into this code
                raise KeyboardInterrupt
            terminal.see_off()
        except (
            terminal.ReaderGoneError,
            SystemExit,
        ):  # typer ends so when a reader of help is gone
            terminal.give_up_output()
            return DONE
        except (Exception, KeyboardInterrupt) as error:
            if debug:
                terminal.complain_in_full(error)
            return _explain(error)
    return code if isinstance(code, int) else DONE


@cache
def _command(names: tuple[str, ...]) -> Any:
    """The program as it is run, made of its functions once."""
    return get_command(program(names))


def _explain(error: BaseException) -> int:
    """Write one line about what went wrong and give the exit code."""
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        terminal.say("interrupted")
        return INTERRUPTED
    if isinstance(error, TridentifyError):
        terminal.complain(str(error))
        refused = isinstance(error, (IdentifiabilityError, ConvergenceError))
        return NO_ANSWER if refused else BAD_INPUT
    # typer's usage errors share no public base class over the versions that are supported
    usage: Any = error
    if hasattr(usage, "format_message"):
        path = getattr(getattr(usage, "ctx", None), "command_path", terminal.PROGRAM)
        message = usage.format_message().replace("Value error, ", "").strip().rstrip(".")
        terminal.complain(f"{message}; see {path} --help")
        return BAD_INPUT
    if isinstance(error, OSError):
        terminal.complain(
            f"found no way to go on ({error}); expected files and streams that can be read and "
            "written; free some space or correct the permissions"
        )
        return BAD_INPUT
    terminal.complain(
        f"stopped by an unforeseen {type(error).__name__}: {error}; run it again with --debug and "
        "report what it shows"
    )
    return FAULT


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """Let a polite request to end, as `timeout` or a closing terminal sends, tidy up as Ctrl-C."""
    raise KeyboardInterrupt


def _kills(handler: Any) -> bool:
    """Whether a signal is at its default: one that is ignored, as under nohup, stays ignored."""
    return handler is signal.SIG_DFL
