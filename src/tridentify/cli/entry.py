"""The way in: light, so that the program can be interrupted from its first moment."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

from tridentify.cli.codes import INTERRUPTED

_NOTICE = b"tridentify: interrupted\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        What stands after the name of the program; by default this process is the program.

    Returns
    -------
    int
        0 done; 1 the data do not allow an answer; 2 bad input or usage; 70 a fault of the program;
        130 interrupted.

    Examples
    --------
    >>> main(["--version"])
    tridentify ...
    0
    """
    if arguments is not None:
        from tridentify.cli.app import run

        return run(arguments)
    # an interrupted import leaves half a module, and some libraries take it for a missing one;
    # one that is ignored, as in the background of a script, stays ignored
    interruptible = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if interruptible:
        signal.signal(signal.SIGINT, _end_at_once)
        # the last thing at exit: from there on Python would leave the signal to kill the process
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    _fill_closed_descriptors()
    from tridentify.cli.app import needed, program, run
    from tridentify.writing.interruption import repeated_where_lost

    program(needed(sys.argv[1:]))
    answer = _end_at_once if interruptible else signal.getsignal(signal.SIGINT)
    try:
        with repeated_where_lost():
            if interruptible:
                signal.signal(signal.SIGINT, signal.default_int_handler)
            code = run(sys.argv[1:])
            signal.signal(signal.SIGINT, answer)
    except KeyboardInterrupt:  # a second one while the first was being answered, or a late one
        signal.signal(signal.SIGINT, answer)
        _notify()
        code = INTERRUPTED
    if code == INTERRUPTED:
        _end_tidily()
    return code


def _end_tidily() -> None:
    """End after an interruption, with its exit code.

    Where the signal met code made by `exec`, as that of a dataclass, Python remembers it whoever
    answered it, and would end by killing itself.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    atexit._run_exitfuncs()
    os._exit(INTERRUPTED)


def _end_at_once(_number: int, _frame: FrameType | None) -> None:
    _notify()
    os._exit(INTERRUPTED)


def _notify() -> None:
    with contextlib.suppress(OSError):
        os.write(2, _NOTICE)


def _fill_closed_descriptors() -> None:
    """Let no file that is opened later become standard input, output or error by its number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
            os.set_inheritable(opened, True)
