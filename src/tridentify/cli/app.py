"""The commands put together, and the way from an exception to one line and an exit code."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from functools import cache
from types import FrameType
from typing import Annotated, Any

import typer
from typer.main import get_command

from tridentify.cli import (
    advise_command,
    app_command,
    channels_command,
    compare_command,
    demo_command,
    excite_command,
    export_command,
    fleet_command,
    identify_command,
    manoeuvres_command,
    physical_command,
    select_command,
    stream_command,
    study_command,
    terminal,
    validate_command,
    warm_command,
)
from tridentify.cli.codes import BAD_INPUT, DONE, FAULT, INTERRUPTED, NO_ANSWER
from tridentify.cli.groups import with_groups
from tridentify.errors import ConvergenceError, IdentifiabilityError, TridentifyError
from tridentify.writing.views import unseen

EXIT_CODES = (
    "Exit codes: 0 done; 1 the data do not allow an answer; 2 bad input or usage; 70 a fault of "
    "this program; 130 interrupted. Results go to standard output, progress and errors to "
    "standard error."
)

app = typer.Typer(
    name=terminal.PROGRAM,
    help="Physical coefficients of continuous-time models from sampled, noisy records.",
    epilog=EXIT_CODES,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
COMMANDS: dict[str, Callable[..., None]] = {
    "advise": advise_command.advise,
    "manoeuvres": manoeuvres_command.manoeuvres,
    "identify": identify_command.identify,
    "select": select_command.select,
    "physical": physical_command.physical,
    "channels": channels_command.channels,
    "demo": demo_command.demo,
    "stream": stream_command.stream,
    "app": app_command.workbench,
    "study": study_command.study,
    "fleet": fleet_command.fleet,
    "excite": excite_command.excite,
    "export": export_command.export,
    "validate": validate_command.validate,
    "warm": warm_command.warm,
    "compare": compare_command.compare_models,
}
for _name, _command_of in COMMANDS.items():
    app.command(_name)(with_groups(_command_of))


def _show_version(asked: bool) -> None:
    if asked:
        from tridentify import __version__

        terminal.show(f"{terminal.PROGRAM} {__version__}")
        raise typer.Exit()


@app.callback(invoke_without_command=True)
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
    termination = terminal.on_signals(("SIGTERM", "SIGHUP"), _interrupt, _kills)
    with terminal.patient_streams(), termination, unseen():
        try:
            terminal.check_output()
            code = _command().main(given, prog_name=terminal.PROGRAM, standalone_mode=False)
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
def _command() -> Any:
    """The commands as they are run, made of their functions once."""
    return get_command(app)


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
        message = usage.format_message().strip().rstrip(".")
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
