"""What a record can tell before anything is fitted."""

from tridentify.judgement.advice.frequency import FrequencyResponse, frequency_response
from tridentify.judgement.advice.manoeuvres import Manoeuvre, find_manoeuvres
from tridentify.judgement.advice.result import Advice
from tridentify.judgement.advice.seen import DelaySeen
from tridentify.judgement.advice.survey import advise

__all__ = [
    "Advice",
    "DelaySeen",
    "FrequencyResponse",
    "Manoeuvre",
    "advise",
    "find_manoeuvres",
    "frequency_response",
]
