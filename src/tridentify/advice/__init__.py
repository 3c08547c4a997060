"""What a record can tell before anything is fitted."""

from tridentify.advice.frequency import FrequencyResponse, frequency_response

__all__ = ["FrequencyResponse", "frequency_response"]
