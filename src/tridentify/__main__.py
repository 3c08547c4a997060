"""``python -m tridentify`` is the command ``tridentify``."""

from __future__ import annotations

import sys

from tridentify.cli import main

if __name__ == "__main__":
    sys.exit(main())
