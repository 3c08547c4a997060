"""The command line: the only room that prints, and the only one that ends with an exit code.

`entry` is the way in, `app` puts the commands together, one module each. `terminal` knows the two
streams, `tables` shows an estimate, `results` writes a folder whole or not at all.
"""

from __future__ import annotations

from tridentify.cli.entry import main

__all__ = ["main"]
