"""One unit read and worked on in this process, and what is to be said if that fails."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

from tridentify.errors import ConvergenceError, IdentifiabilityError, TridentifyError
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.fleet.job import BAD_INPUT, FAULT, NO_ANSWER, OVER_MEMORY, Item
from tridentify.record.formats.assemble import Wanted
from tridentify.record.record import Record


class RecordJob(ABC):
    """What is done with the records of one unit, in a process that may crash.

    Attributes
    ----------
    wanted : Wanted
        How files and frames are read.
    """

    wanted: Wanted

    def begin(self) -> None:
        """Load the compiled functions; the first time on a machine they are compiled."""
        from tridentify.estimation.machine_code import load_kernels

        load_kernels()

    @abstractmethod
    def run(self, item: Item, records: Sequence[Record]) -> dict[str, Any]:
        """The answer, as JSON can hold it."""

    def attempt(self, item: Item, read: Callable[[str], None] | None = None) -> dict[str, Any]:
        """What came of an item, as the fields of `Outcome` beside it.

        Parameters
        ----------
        item : Item
        read : callable, optional
            Told the fingerprint of the records once they are read.

        Returns
        -------
        dict
            As JSON can hold it.
        """
        begin = time.perf_counter()
        mark, told = "", {}
        try:
            records = item.place.records(self.wanted)
            mark = fingerprint(records)
            if read is not None:
                read(mark)
            told = {"value": self.run(item, records)}
        except (BrokenPipeError, KeyboardInterrupt):
            raise
        except BaseException as error:  # a panic of a compiled reader is no Exception
            told = described(error)
            mark = mark or item.place.trace()
        return told | {"seconds": time.perf_counter() - begin, "fingerprint": mark}


def described(error: BaseException) -> dict[str, Any]:
    r"""Status, message and class of what was raised.

    Examples
    --------
    >>> described(ValueError("two\nlines"))["message"]
    'two lines'
    """
    status = FAULT
    if isinstance(error, MemoryError):
        status = OVER_MEMORY
    elif isinstance(error, IdentifiabilityError | ConvergenceError):
        status = NO_ANSWER
    elif isinstance(error, TridentifyError):
        status = BAD_INPUT
    text = " ".join(str(error).split())
    if status == OVER_MEMORY:
        text = "found no more memory within the limit; expected a record that needs less; raise "
        text += "memory_limit, name fewer channels or cut the record"
    return {"status": status, "message": text, "exception": type(error).__name__}
