"""Several models on several records: responses, fits, poles and gains side by side."""

from tridentify.judgement.comparison.compare import compare
from tridentify.judgement.comparison.result import Comparison

__all__ = ["Comparison", "compare"]
