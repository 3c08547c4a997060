"""What is asked of a stream, and how far it has been read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tridentify.cli.load import MissingRule
from tridentify.errors import OptionError
from tridentify.record.formats.streams.header import Asked
from tridentify.structure import Structure

if TYPE_CHECKING:
    from tridentify.online import Estimator


@dataclass(frozen=True)
class StreamQuestion:
    """What is asked of a stream.

    Attributes
    ----------
    asked : Asked
        Which columns.
    structure : Structure
    method : Estimator
    dt : float or None
        Nominal step [s]; None to take it from the first samples.
    intersample : str
    rules : sequence of MissingRule
        Output samples that do not count.
    every : float
        Time of the data between two lines [s].
    """

    asked: Asked
    structure: Structure
    method: Estimator
    dt: float | None
    intersample: str
    rules: Sequence[MissingRule]
    every: float

    def to_dict(self) -> dict[str, Any]:
        """Give what a checkpoint has to agree with, as plain values."""
        asked = self.asked
        return {
            "inputs": list(asked.inputs),
            "outputs": list(asked.outputs),
            "method": self.method.to_dict(),
            "structure": self.structure.to_dict(),
            "time": asked.time,
            "dt": self.dt,
            "intersample": self.intersample,
            "missing": [f"{rule.channel}{rule.sign}{rule.limit!r}" for rule in self.rules],
        }


@dataclass
class StreamPlace:
    """How far a stream was read, in step with the estimator's state; what came out and was lost."""

    position: int = 0
    line: int = 0
    malformed: int = 0
    time: float = 0.0
    elapsed: float = 0.0
    emitted: int = 0
    dropped: int | None = None


def check_every(every: float) -> None:
    """Refuse what is no time between two lines.

    Raises
    ------
    OptionError
    """
    if not every > 0.0:
        raise OptionError(
            f"found --every {every:g}; expected seconds above zero, or inf; correct it"
        )
