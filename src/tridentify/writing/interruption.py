"""Steps that an interruption must not cut in two."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

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
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked: list[tuple[int, FrameType | None]] = []
    numbers = [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    held = {number: handler for number, handler in before.items() if callable(handler)}
    for number in held:
        signal.signal(number, lambda number, frame: asked.append((number, frame)))
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
    for number, frame in asked[:1]:
        held[signal.Signals(number)](number, frame)
