"""Answers to signals, and steps that an interruption must not cut in two."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""By which a user or the system asks to end."""

SOON = 0.01
"""After what time an interruption that was lost is repeated [s]: what lost it is over by then."""


@contextmanager
def repeated_where_lost() -> Iterator[None]:
    """Interrupt again where an interruption met code whose exceptions nobody can catch.

    Such code clears up behind an object that goes, or is called by a library written in C. Python
    would print a traceback and go on as if nobody had asked to end.

    Examples
    --------
    >>> import time, weakref
    >>> class Going: ...
    >>> thing, sought = Going(), lambda _: signal.raise_signal(signal.SIGINT)
    >>> reference = weakref.ref(thing, sought)
    >>> try:
    ...     with repeated_where_lost():
    ...         del thing
    ...         time.sleep(60.0)
    ... except KeyboardInterrupt:
    ...     print("interrupted")
    interrupted
    """
    before = sys.unraisablehook

    def repeat(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            # from another thread, as one that comes here and now would be lost here, too
            again = threading.Timer(SOON, _interrupt)
            again.daemon = True
            again.start()
        else:
            before(lost)

    sys.unraisablehook = repeat
    try:
        yield
    finally:
        sys.unraisablehook = before


def _interrupt() -> None:
    """Send the main thread the first signal that a function answers."""
    numbers = [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]
    for number in filter(lambda one: callable(signal.getsignal(one)), numbers):
        if hasattr(signal, "pthread_kill"):  # which wakes what waits, too
            signal.pthread_kill(threading.main_thread().ident or 0, number)
        else:
            _thread.interrupt_main(number)
        return


@contextmanager
def held_back() -> Iterator[None]:
    """Let requests to end wait until a short step is done, and answer them then.

    For a process that is being started, which would complain of half of what it is told, and for a
    folder that is made before anybody knows of it. Only what a function answers can wait; in other
    threads than the first nothing is held back, as signals do not come there.

    Examples
    --------
    >>> done = []
    >>> try:
    ...     with held_back():
    ...         signal.raise_signal(signal.SIGINT)
    ...         done.append("step")
    ... except KeyboardInterrupt:
    ...     done.append("interruption")
    >>> done
    ['step', 'interruption']
    """
    asked: list[tuple[int, FrameType | None]] = []
    with on_signals(SIGNALS, lambda *signalled: asked.append(signalled), callable) as held:
        yield
    for number, frame in asked[:1]:
        held[number](number, frame)


@contextmanager
def on_signals(
    names: Sequence[str],
    answer: Callable[[int, FrameType | None], None],
    takes: Callable[[Any], bool],
) -> Iterator[dict[int, Any]]:
    """Answer signals while this lasts, in the main thread, which alone is sent any.

    Parameters
    ----------
    names : sequence of str
        Those that the system does not know are left out.
    answer : callable
        Told of a signal.
    takes : callable
        Whether one that was handled so before is to be answered.
    """
    if threading.current_thread() is not threading.main_thread():
        yield {}
        return
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    handled = {number: handler for number, handler in before.items() if takes(handler)}
    for number in handled:
        signal.signal(number, answer)
    try:
        yield handled
    finally:
        for number, handler in handled.items():
            signal.signal(number, handler)
