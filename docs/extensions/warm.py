"""Processes of pages that are warm from their start.

Every page with cells has a kernel of its own and every command a process, and most of their time
went into loading the same libraries and compiled loops. So one process loads these and waits; for
each kernel and each command it makes a copy of itself (a fork), which takes on the arguments,
folder, environment and standard streams of whoever asked.

    python warm.py serve SOCKET                    until its standard input is closed
    python -IS warm.py ask SOCKET tridentify ...   in place of `tridentify ...`
    python -IS warm.py ask SOCKET kernel ...       in place of `python -m ipykernel_launcher ...`

Where there is no fork everybody starts anew.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

LARGEST = 1 << 20
"""Bytes of a question: arguments and environment."""
PATIENCE = 120.0
"""Seconds that the warm process may take to load."""
NUMBER = struct.Struct("!i")
COMMAND = (sys.executable, "-IS", __file__, "ask")
"""In front of the socket, what is asked for, and arguments."""
NEEDED = (
    *("ipykernel.kernelapp", "ipykernel.zmqshell", "matplotlib_inline.backend_inline"),
    *("matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg"),
    *("tridentify.cli.app", "tridentify.cli.groups", "tridentify.cli.tables"),
)
_STARTED: list[subprocess.Popen[bytes]] = []


# ------------------------------------------------------------------------------- whoever asks
def ask(path: str, kind: str, arguments: list[str]) -> int:
    """Have something done by a copy of the warm process, and give its exit code."""
    question = {"kind": kind, "argv": arguments, "cwd": os.getcwd(), "env": dict(os.environ)}
    with socket.socket(socket.AF_UNIX) as line:
        connect(line, path)
        socket.send_fds(line, [json.dumps(question).encode() + b"\n"], [0, 1, 2])
        (pid,) = NUMBER.unpack(line.recv(NUMBER.size, socket.MSG_WAITALL))

        def forward(number: int, _frame: object) -> None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, forward)
        answer = line.recv(NUMBER.size, socket.MSG_WAITALL)
    return NUMBER.unpack(answer)[0] if answer else 1


def connect(line: socket.socket, path: str) -> None:
    """Wait until the warm process is there."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return line.connect(path)
        except (FileNotFoundError, ConnectionRefusedError):
            if time.monotonic() > end:
                raise
            time.sleep(0.02)


# --------------------------------------------------------------------------- the warm process
def start(folder: Path) -> str:
    """Start the warm process and give its socket; none where there is no fork."""
    if not hasattr(os, "fork"):
        return ""
    path = str(folder / "warm")
    process = subprocess.Popen([sys.executable, __file__, "serve", path], stdin=subprocess.PIPE)
    _STARTED.append(process)  # it ends when this process does, and with it the pipe
    return path


def load() -> None:
    """What most pages need. Not polars, whose threads would not be there in a copy."""
    for name in NEEDED:
        import_module(name)
    from tridentify.estimation.machine_code import load_kernels

    load_kernels()


def serve(path: str) -> int:
    """Make copies until standard input is closed; in a copy, do what was asked."""
    load()
    gc.collect()
    gc.freeze()  # a collection would touch, and so copy, all that the copies share
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for those who wait
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(path)
        door.listen()
        while True:
            ready, _, _ = select.select([door, 0], [], [])
            if 0 in ready:
                return 0
            line, _ = door.accept()
            if os.fork() == 0:
                door.close()
                keep(line)
            line.close()


def keep(line: socket.socket) -> NoReturn:
    """Make the copy that does it; tell its number and its exit code, and end it with who asked."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    text, streams, _, _ = socket.recv_fds(line, LARGEST, 3)
    while not text.endswith(b"\n"):
        text += line.recv(LARGEST)
    ends, held = os.pipe()  # closed when the copy has ended
    pid = os.fork()
    if pid == 0:
        line.close()
        os.close(ends)
        end(do, json.loads(text), streams)
    os.close(held)
    for stream in streams:
        os.close(stream)
    line.sendall(NUMBER.pack(pid))
    ready, _, _ = select.select([line, ends], [], [])
    if ends not in ready:
        os.kill(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    with contextlib.suppress(OSError):
        line.sendall(NUMBER.pack(os.waitstatus_to_exitcode(status)))
    os._exit(0)


def end(work: Callable[..., int], *given: Any) -> NoReturn:
    """End with what the work gives, without taking all that was loaded to pieces."""
    code = 1
    try:
        code = work(*given)
    except SystemExit as asked:
        code = asked.code if isinstance(asked.code, int) else int(asked.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        atexit._run_exitfuncs()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def do(question: dict[str, Any], streams: list[int]) -> int:
    """What was asked, in this process."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", closefd=False, errors="backslashreplace")  # noqa: SIM115
    os.chdir(question["cwd"])
    os.environ.clear()
    os.environ.update(question["env"])
    if question["kind"] == "kernel":
        from ipykernel import kernelapp

        kernelapp.launch_new_instance(argv=question["argv"], parent_handle=os.getppid())
        return 0
    import matplotlib

    matplotlib.rcParams["backend"] = os.environ.get("MPLBACKEND", "agg")
    sys.argv = ["tridentify", *question["argv"]]
    from tridentify.cli import main

    return main()


if __name__ == "__main__":
    what, where, *more = sys.argv[1:]
    if what == "serve":
        sys.path.pop(0)  # the folder of the extensions
        sys.exit(serve(where))
    sys.exit(ask(where, more[0], more[1:]))
