"""What may be wrong with the samples or with what they say."""

from __future__ import annotations

import enum

__all__ = ["Flag"]


class Flag(enum.Flag):
    """What a sample, or the samples of late, are found to be. Nothing is ``Flag(0)``.

    Examples
    --------
    >>> from tridentify import online
    >>> flags = online.Flag.STUCK | online.Flag.OUTLIER
    >>> online.Flag.STUCK in flags, bool(online.Flag(0))
    (True, False)
    >>> online.Flag.STUCK.words
    ('an output that stands still while the model moves; it is not used',)
    """

    MISSING_OUTPUT = enum.auto()
    MISSING_INPUT = enum.auto()
    JITTER = enum.auto()
    OUTLIER = enum.auto()
    STUCK = enum.auto()
    SATURATED = enum.auto()
    NOT_EXCITED = enum.auto()
    CHANGED = enum.auto()
    NOT_READY = enum.auto()

    @property
    def words(self) -> tuple[str, ...]:
        """What is the matter, a sentence for each flag."""
        return tuple(_WORDS[one] for one in self)


_WORDS = {
    Flag.MISSING_OUTPUT: "an output sample is missing",
    Flag.MISSING_INPUT: "an input sample is missing; the one before is held",
    Flag.JITTER: "the time since the sample before is not the sampling interval",
    Flag.OUTLIER: "an output far from what is expected of it; it is not used",
    Flag.STUCK: "an output that stands still while the model moves; it is not used",
    Flag.SATURATED: "an output at its limit while the model is beyond; it is not used",
    Flag.NOT_EXCITED: "the input tells nothing new of some combination of coefficients",
    Flag.CHANGED: "the coefficients have moved",
    Flag.NOT_READY: "the samples so far do not determine the coefficients",
}
