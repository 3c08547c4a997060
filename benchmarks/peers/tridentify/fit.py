"""tridentify as its README shows it.

"ThreeModel()" is told nothing but the numbers of poles and zeros; "ThreeModel(), told" also what
the others are told or suppose: no offset, at rest before the first sample.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from protocol import Task, serve

from tridentify import Record, Structure, ThreeModel, identify


def alone(task: Task) -> object:
    record = Record(task.u, task.y, dt=task.dt)
    return identify(record, Structure(task.poles, task.zeros), ThreeModel()).theta


def told(task: Task) -> object:
    record = Record(task.u, task.y, dt=task.dt)
    structure = Structure(task.poles, task.zeros, offset=False, initial_state="rest")
    return identify(record, structure, ThreeModel()).theta


serve({"ThreeModel()": alone, "ThreeModel(), told": told}, ("tridentify", "numpy", "scipy"))
