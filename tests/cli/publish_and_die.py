"""Publish a set of files again and again, and be killed at another moment each time.

``python publish_and_die.py WAY`` prints a line for each moment: what the folder holds after the
kill (old, new, mixed), what it holds for a reader of models, whether the user's files are there,
and whether the next run succeeds.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

from tridentify.cli import publishing
from tridentify.cli.results import ResultFolder
from tridentify.writing.files import published

NAMES = ("bode.png", "model.json", "report.html")
MOMENTS = 400
"""More than any way has; the last line is of a run that was not killed."""


def publish(target: Path, content: str, names: tuple[str, ...] = NAMES) -> None:
    with ResultFolder(target) as results:
        for name in names:
            (results.draft / name).write_text(content)
        results.publish()


def prepare(place: Path, way: str) -> Path:
    target = place / "out"
    if way == "new":
        return target
    publish(target, "old")
    (target / "notes.txt").write_text("mine")
    if way == "folder":
        (target / "raw").mkdir()
        (target / "raw" / "flight.csv").write_text("mine")
    if way == "standing":
        os.chdir(target)
    if way == "unlike":
        publishing._exchange_of_system = lambda: None
    return target


def die_at(moment: int) -> None:
    """Kill this process before its so many-th step that touches the disk."""
    left = [moment]

    def watch(event: str, _arguments: object) -> None:
        if event == "open" or event.startswith(("os.", "shutil.", "fcntl.")):
            left[0] -= 1
            if not left[0]:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)


def held(paths: list[Path]) -> str:
    found = {path.read_text() if path.is_file() else "absent" for path in paths}
    return found.pop() if len(found) == 1 else "mixed"


def mine(target: Path, way: str) -> bool:
    names = {"new": (), "folder": ("notes.txt", "raw/flight.csv")}.get(way, ("notes.txt",))
    return all((target / name).read_text() == "mine" for name in names)


def once(way: str, moment: int) -> bool:
    """One run; say whether it ended by itself."""
    place = Path(tempfile.mkdtemp())
    target = prepare(place, way)
    child = os.fork()
    if not child:
        die_at(moment)
        publish(target, "new")
        os._exit(0)
    _, status = os.waitpid(child, 0)
    paths = [target / name for name in NAMES]
    raw, read = held(paths), held([published(path) for path in paths])
    kept = mine(target, way)
    publish(target, "next")
    again = held(paths) == "next" and mine(target, way)
    print(raw, read, kept, again, flush=True)
    os.chdir("/")
    shutil.rmtree(place)
    return not os.WIFSIGNALED(status)


if __name__ == "__main__":
    for moment in range(1, MOMENTS):
        if once(sys.argv[1], moment):
            break
