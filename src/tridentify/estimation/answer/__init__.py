"""The answer: coefficients with uncertainty, what was estimated along, trace, findings, file."""
