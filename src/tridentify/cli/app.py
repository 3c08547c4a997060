"""The commands put together, and the way from an exception to one line and an exit code.

Groups of options (`groups`) spread out into the parameters of a command, with their help.
"""

from __future__ import annotations

import inspect
import re
import signal
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, wraps
from importlib import import_module
from types import FrameType
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.main import get_command

from tridentify.cli import terminal
from tridentify.cli.codes import BAD_INPUT, DONE, FAULT, INTERRUPTED, NO_ANSWER
from tridentify.errors import ConvergenceError, IdentifiabilityError, TridentifyError
from tridentify.writing.interruption import on_signals
from tridentify.writing.views import unseen


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command with every group of options spread out, each with its help.

    Parameters
    ----------
    command : callable
        Parameters annotated with a dataclass of options are groups. What its docstring says of a
        parameter, or that of a group of an attribute, is the help where the option states none.

    Examples
    --------
    >>> from tridentify.cli.groups import Way
    >>> def fit(file: str, way: Way, out: str | None = None) -> None:
    ...     print(way.method, out)
    >>> list(inspect.signature(with_groups(fit)).parameters)
    ['file', 'method', 'noise', 'route', 'controller', 'out']
    >>> with_groups(fit)(file="a.csv", out="b", **vars(Way("output-error")))
    output-error b
    """
    hints = _hints(command)
    groups: dict[str, type[Any]] = {}
    spread: list[inspect.Parameter] = []
    for name, own in inspect.signature(command).parameters.items():
        kind = hints[name]
        if not is_dataclass(kind):
            spread.append(own.replace(annotation=kind, kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        groups[name] = kind  # type: ignore[assignment]
        inner = _hints(kind)
        spread += [
            inspect.Parameter(
                one.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if one.default is MISSING else one.default,
                annotation=inner[one.name],
            )
            for one in fields(kind)
        ]

    @wraps(command)
    def run(**given: Any) -> None:
        made = {
            name: group(**{one.name: given.pop(one.name) for one in fields(group)})
            for name, group in groups.items()
        }
        command(**given, **made)

    run.__signature__ = inspect.Signature(spread)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in spread}
    run.__doc__ = re.split(SECTION, inspect.getdoc(command) or "")[0]
    del run.__wrapped__
    return run


def _hints(documented: Any) -> dict[str, Any]:
    """Annotations of a command or a group, its options with what the docstring says of them."""
    hints = get_type_hints(documented, include_extras=True)
    for one in getattr(documented, "__mro__", (documented,)):
        for name, text in described(one.__doc__ or "").items():
            kind, option = get_args(hints[name])
            if option.help is None:
                option = copy(option)
                option.help = text
                hints[name] = Annotated[kind, option]
    return hints


SECTION = r"\n *(?:Parameters|Attributes)\n *-{10}\n"


def described(docstring: str) -> Mapping[str, str]:
    """What a docstring says of each parameter or attribute.

    Examples
    --------
    >>> from tridentify.cli.groups import ReadingMany
    >>> described(ReadingMany.__doc__)["start"]
    'Leave out what is before.'
    """
    _, *sections = re.split(SECTION, inspect.cleandoc(docstring))
    entries = re.findall(r"^(\w+)\n((?: +.*\n?)+)", "".join(sections), re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


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
