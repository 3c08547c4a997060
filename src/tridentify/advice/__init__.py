"""What a record can tell before anything is fitted."""

from tridentify.advice.frequency import FrequencyResponse, frequency_response
from tridentify.advice.result import Advice
from tridentify.advice.seen import DelaySeen
from tridentify.advice.survey import advise

__all__ = ["Advice", "DelaySeen", "FrequencyResponse", "advise", "frequency_response"]
