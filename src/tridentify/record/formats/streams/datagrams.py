"""Datagrams of the loopback address as a source of lines."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import struct
import sys
from collections.abc import Iterator
from urllib.parse import urlsplit

from tridentify.errors import OptionError, UnreadableFileError, shown
from tridentify.record.formats.streams.sources import PIECE, WAIT, Chunk, Mark

_RXQ_OVFL = getattr(socket, "SO_RXQ_OVFL", 40) if sys.platform == "linux" else None
"""Socket option that has Linux tell, with a datagram, how many were dropped before it."""
_MEMINFO, _DROPS = 55, slice(32, 36)
"""Socket option that tells it at any time (Linux 4.12 and later), and where in its answer."""
_COUNT = struct.Struct("=I")


def loopback_address(text: str) -> tuple[str, int]:
    """Read an address such as ``udp://127.0.0.1:9000``.

    Parameters
    ----------
    text : str
        The host may be left out.

    Returns
    -------
    host : str
    port : int
        Zero for any that is free.

    Raises
    ------
    OptionError
        It is none, or not one of this machine alone.

    Examples
    --------
    >>> loopback_address("udp://:9000"), loopback_address("udp://[::1]:0")
    (('127.0.0.1', 9000), ('::1', 0))
    """
    expected = "expected udp://127.0.0.1:PORT, the loopback address, with a port from 0 to 65535"
    try:
        parts = urlsplit(text)
        host, port = parts.hostname or "127.0.0.1", parts.port
    except ValueError:
        port = None
    if port is None or parts.path or parts.query or parts.fragment or parts.username:
        raise OptionError(f"found {shown(text)}; {expected}; correct it")
    try:
        known = ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        known = None
    if known is None or not known.is_loopback:
        raise OptionError(
            f"found {shown(text)}, which is no address of this machine alone; {expected}; forward "
            "what comes from elsewhere"
        )
    return str(known), port


class UdpSource:
    """Datagrams on the loopback address, each with one line or several.

    Parameters
    ----------
    host : str
    port : int
        Zero for any that is free; `name` then says which.

    Attributes
    ----------
    dropped : int or None
        Datagrams that the system dropped since nobody had read those before; None where the system
        does not tell.

    Raises
    ------
    UnreadableFileError
        The port is taken or not permitted.
    """

    positioned = False

    def __init__(self, host: str, port: int) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
            self._told: int | None = self._ask_for_drops()
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise UnreadableFileError(
                f"found no way to listen at {host}, port {port} ({error.strerror}); expected a "
                "free port; choose another one, or 0 for any"
            ) from error
        shown_host = f"[{host}]" if ":" in host else host
        self.name = f"udp://{shown_host}:{self._socket.getsockname()[1]}"

    def pieces(self) -> Iterator[Chunk | None]:
        """Give the datagrams that are there, together, for ever."""
        position = 0
        while True:
            data = b"".join(self._waiting())
            yield Chunk(data, position) if data else None
            position += len(data)

    def _waiting(self) -> Iterator[bytes]:
        size = 0
        self._socket.settimeout(WAIT)
        while size < PIECE:
            try:
                data = self._receive()
            except (TimeoutError, BlockingIOError):
                return
            self._socket.setblocking(False)
            size += len(data)
            yield data if data.endswith(b"\n") else data + b"\n"

    def _ask_for_drops(self) -> int | None:
        if _RXQ_OVFL is None:
            return None
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, _RXQ_OVFL, 1)
        except OSError:
            return None
        return 0

    def _receive(self) -> bytes:
        if self._told is None:
            return self._socket.recv(1 << 16)
        data, notes, _, _ = self._socket.recvmsg(1 << 16, socket.CMSG_SPACE(_COUNT.size))
        for level, kind, value in notes:
            if (level, kind) == (socket.SOL_SOCKET, _RXQ_OVFL) and len(value) >= _COUNT.size:
                self._count(value)
        return data

    def _count(self, value: bytes) -> None:
        """Take up the system's counter, which begins anew after 2**32."""
        assert self._told is not None
        now = int(_COUNT.unpack_from(value)[0])
        self._told += (now - self._told) % (1 << 32)

    @property
    def dropped(self) -> int | None:
        """Datagrams that were dropped so far, with those behind the last one that was read."""
        if self._told is not None:
            with contextlib.suppress(OSError):
                value = self._socket.getsockopt(socket.SOL_SOCKET, _MEMINFO, 64)[_DROPS]
                if len(value) == _COUNT.size:
                    self._count(value)
        return self._told

    def mark(self, position: int) -> Mark | None:
        """Give nothing: what was received is gone."""
        return None

    def seek(self, mark: Mark | None) -> None:
        """Go on with what comes."""

    def close(self) -> None:
        """Free the port."""
        self._socket.close()
