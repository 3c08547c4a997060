"""What the program's exit code says."""

from __future__ import annotations

DONE = 0
NO_ANSWER = 1
BAD_INPUT = 2
FAULT = 70
INTERRUPTED = 130
