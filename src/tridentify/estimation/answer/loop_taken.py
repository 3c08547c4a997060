"""What an estimate by the reference route took the loop for."""

from __future__ import annotations

from dataclasses import dataclass

from tridentify.errors import DataError, shown
from tridentify.transfer_function import TransferFunction

SAMPLINGS = ("sampled", "continuous")


@dataclass(frozen=True, eq=False)
class LoopTaken:
    """What an estimate by the reference route took the loop for.

    Attributes
    ----------
    sampling : {"sampled", "continuous"}
        How the controller worked: its output held between the samples, or not.
    controller : TransferFunction or None
        The controller, where it was given.
    mirrored : bool
        Whether the errors were those of the mirrored predictor, as of a plant that is not stable.

    Raises
    ------
    DataError
        The kind of controller is none of these.
    """

    sampling: str
    controller: TransferFunction | None = None
    mirrored: bool = False

    def __post_init__(self) -> None:
        if self.sampling not in SAMPLINGS:
            raise DataError(
                f"found a controller taken as {shown(self.sampling)}; expected 'sampled' or "
                "'continuous'; name one of them"
            )
