"""A process of this Python beside this one: pipes in and out, and a folder of its own.

It inherits neither the user's packages nor the folder that this process stands in (``-I``); what it
prints on its own goes nowhere.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping


class ChildProcess(subprocess.Popen[bytes]):
    """A child that runs ``boot``, with temporary files in a folder that ends with it.

    Parameters
    ----------
    boot : str
        Python code; its standard input and output are the pipes.
    environment : mapping of str to str
        Beside what this process has.

    Raises
    ------
    OSError
        It cannot be started.
    """

    def __init__(self, boot: str, environment: Mapping[str, str]) -> None:
        # a child that is killed cannot clear up the temporary files of its libraries
        self.folder = tempfile.TemporaryDirectory(prefix="tridentify-", ignore_cleanup_errors=True)
        temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), self.folder.name)
        try:
            super().__init__(
                [sys.executable, "-I", "-c", boot],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **temporary, **environment},
            )
        except OSError:
            self.folder.cleanup()
            raise

    def end(self) -> None:
        """Kill it, wait until it is gone, and clear up after it."""
        self.kill()
        self.wait()
        for stream in (self.stdin, self.stdout):
            if stream is not None:
                with contextlib.suppress(OSError, ValueError):
                    stream.close()
        self.folder.cleanup()
