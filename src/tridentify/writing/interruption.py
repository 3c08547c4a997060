"""Answers to signals, and steps that an interruption must not cut in two."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""By which a user or the system asks to end."""


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
