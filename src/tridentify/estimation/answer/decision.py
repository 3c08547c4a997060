"""What was decided on the way to an estimate, in words, and what the words are about.

Most decisions are told to people alone. Those that other rooms act upon carry a
`DecisionKind`, so that nothing depends on how a sentence is put. A file holds the words alone:
`recalled` is the one place where the kind is read off them.
"""

from __future__ import annotations

import enum

Decisions = tuple[str, ...]
"""As a trace holds them, in the order in which they were taken."""


class DecisionKind(enum.Enum):
    """What a decision is about; the value is how its words begin."""

    OTHER_DELAYS = "other delays explain the record almost as well"
    REPEATED_INPUT = "the input repeats itself"
    RESPONSE_AS_NOISE = "the noise model may take a slow response for noise"
    SLOW_AS_NOISE = "the noise model explains slow parts of the output that white weights follow"
    FAR_LIKELIER = "a model of the noise makes the record far likelier and moves coefficients"
    NOISE_WHITE = "noise white"
    NOISE_TAKEN_AS_WHITE = "noise taken as white"
    NOISE_COLOURED = "noise coloured"
    NOISE_MODEL = "noise model"
    NOISE_LEVELS = "noise level of each experiment"
    INITIAL_STATE = "initial state"
    SLOW_DRIFT = "a slow disturbance is estimated along as a polynomial in time"
    BETWEEN_DECIDES = "what the input does between its samples decides"
    RESTS_ON_HELD = "the input counts as held between its samples, as the record says"
    SEEN_HELD = "a controller that works on the samples holds the input"
    NO_END_TOGETHER = "plant and noise together come to no end"
    ANOTHER_PLANT = "another plant is nearly as likely"
    INPUT_TAKEN = "input taken as"
    MOVES_TIMED = "the input moves between its samples: when is estimated along"
    ORDERS_CHOSEN = "poles, zeros ="
    DIRECT_ROUTE = "route direct"
    NOT_INDEPENDENT = (
        "the innovations hold past samples, errors reach as far as those of white weights"
    )

    def told(self, rest: str = "") -> KnownDecision:
        """The decision, in words.

        Parameters
        ----------
        rest : str
            What follows its beginning.

        Examples
        --------
        >>> DecisionKind.NOISE_COLOURED.told(" (as asked for)")
        'noise coloured (as asked for)'
        """
        return KnownDecision(f"{self.value}{rest}", self)


class KnownDecision(str):
    """Words, and what they are about.

    Parameters
    ----------
    words : str
    kind : DecisionKind

    Examples
    --------
    >>> told = KnownDecision("route direct: there is feedback", DecisionKind.DIRECT_ROUTE)
    >>> told, told.rest
    ('route direct: there is feedback', 'there is feedback')
    """

    kind: DecisionKind

    def __new__(cls, words: str, kind: DecisionKind) -> KnownDecision:
        """As a text, with its kind."""
        made = super().__new__(cls, words)
        made.kind = kind
        return made

    def __getnewargs__(self) -> tuple[str, DecisionKind]:  # type: ignore[override]
        return str(self), self.kind

    @property
    def rest(self) -> str:
        """What follows the colon behind the beginning; empty where there is none."""
        return self.removeprefix(self.kind.value).partition(": ")[2]


def recalled(words: str) -> str:
    """A decision from its words, as a file holds them; text of no kind is left as it is.

    Parameters
    ----------
    words : str

    Examples
    --------
    >>> recalled("input taken as held between its samples").kind
    <DecisionKind.INPUT_TAKEN: 'input taken as'>
    """
    for kind in DecisionKind:
        if words.startswith(kind.value):
            return KnownDecision(words, kind)
    return words
