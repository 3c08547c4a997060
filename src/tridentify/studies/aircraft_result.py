"""The result of the study of the paper's aircraft: its numbers, and the text about them."""

from __future__ import annotations

from dataclasses import dataclass

from tridentify.studies.aircraft_numbers import AircraftNumbers
from tridentify.studies.aircraft_text import write_text


@dataclass(frozen=True, eq=False)
class AircraftResult(AircraftNumbers):
    """What ``AircraftStudy().run()`` gives back; see `AircraftNumbers` for what it holds."""

    def table(self) -> str:
        """Text: the tables, the failures, and what the paper's numbers can mean.

        Returns
        -------
        str
            Plain ASCII, at most 78 columns wide.
        """
        return write_text(self)
