"""Files that are identified without being read whole: which, and what is shown of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tridentify.cli import tables
from tridentify.cli.load import RecordSource, find_time
from tridentify.cli.run import usable
from tridentify.cli.terminal import Activity
from tridentify.errors import NonUniformTimeError, UnsupportedError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Method
from tridentify.record.formats.apart.isolation import machine_memory
from tridentify.record.formats.parts import has_parts, open_parts
from tridentify.record.long_record import LongRecord, open_record
from tridentify.record.record import Record
from tridentify.structure import AutoStructure, Structure

LONGEST_HELD = 5_000_000
"""Samples of a file that is still read whole: a minute's estimate and judgement."""

HELD_BYTES = 400
"""Memory that an estimate takes for each number of a record that is read whole, at its peak
(`benchmarks/long_records.py`)."""

SHARE = 4
"""An estimate may take one part in so many of the machine's memory."""


@dataclass(frozen=True, eq=False)
class LongAnswer:
    """The estimate of a record that was read in parts, and the stretch that was judged.

    Attributes
    ----------
    record : LongRecord
    estimate : Estimate
    stretch : Record
    """

    record: LongRecord
    estimate: Estimate
    stretch: Record

    def text(self) -> str:
        """What was identified from what, as `tables.describe_records`."""
        said = tables.describe_records([self.stretch])
        return f"{self.record.n_samples:,} samples, read in parts; of them\n{said}"

    def document(self) -> dict[str, Any]:
        """As `tables.estimate_document`, the record the whole one."""
        found = tables.estimate_document(self.estimate, [self.stretch])
        entry = {
            **found["record"],
            "n_samples": self.record.n_samples,
            "n_missing": None,
            "start": self.record.t0,
            "stop": self.record.t0 + self.record.duration,
        }
        return found | {"record": entry, "experiments": [entry]}


def long_record(
    source: RecordSource,
    structure: Structure | AutoStructure,
    method: Method,
    activity: Activity,
) -> LongRecord | None:
    """The one file as a record that is read in parts, where it is too long for anything else.

    A file of any length that needs what is only done in memory is read whole, as ever.

    Raises
    ------
    DataError
        The file cannot be used.
    """
    from tridentify.judgement.long_record import supported

    wanted, file = source.wanted, source.files[0]
    plain = not (wanted.references or source.missing or source.masked or source.ranges)
    plain = plain and wanted.start is wanted.stop is None
    if len(source.files) > 1 or not plain or not has_parts(file):
        return None
    opened = open_parts(file)
    numbers = opened.n_samples * len(source.columns)
    if not file.is_dir() and not is_too_long(opened.n_samples, numbers):
        return None
    time = wanted.time
    if time is None and wanted.dt is None:
        time = find_time(opened, source.columns)
    try:
        supported(structure, method)
        found = open_record(
            file,
            inputs=wanted.inputs,
            outputs=wanted.outputs,
            time=time,
            dt=wanted.dt,
            intersample=wanted.intersample,
            units=wanted.units,
        )
    except (NonUniformTimeError, UnsupportedError) as error:
        if file.is_dir():
            raise
        activity.note(f"the whole file is read into memory: {str(error).partition(';')[0]}")
        return None
    activity.note(
        f"{found.n_samples:,} samples: read in parts; residual and sensors are judged on a stretch"
    )
    return found


def is_too_long(n_samples: int, numbers: int) -> bool:
    """Whether a file is not to be held in memory.

    Parameters
    ----------
    n_samples : int
    numbers : int
        Samples times channels.

    Examples
    --------
    >>> is_too_long(10_000, 20_000), is_too_long(10_000_000, 20_000_000)
    (False, True)
    """
    return n_samples > LONGEST_HELD or numbers * HELD_BYTES > machine_memory() // SHARE


def answer(
    record: LongRecord,
    structure: Structure | AutoStructure,
    method: Method,
    activity: Activity,
) -> LongAnswer:
    """The estimate, with the stretch that its findings are about.

    Raises
    ------
    DataError, StructureError, IdentifiabilityError
        As `tridentify.identify`.
    ConvergenceError
        The method ended without a usable estimate.
    """
    from tridentify.identify import identify_long

    estimate = usable(identify_long(record, structure, method, activity.stage))
    first, last = 0, record.n_samples - 1
    for one in estimate.findings:
        if one.code == "judged-on-stretch":
            first, last = (round((at - record.t0) / record.dt) for at in one.times)
    return LongAnswer(record, estimate, record.part(first, last + 1))
