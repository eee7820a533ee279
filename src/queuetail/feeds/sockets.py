"""Plain sockets: datagrams by unicast or multicast, and streams over TCP or TLS."""

from __future__ import annotations

import ipaddress
import socket
import ssl
from urllib.parse import urlsplit

TIMEOUT_S = 5.0
CHUNK = 65_536


class Datagrams:
    """Sends datagrams to udp://host:port; nobody tells whether they arrive."""

    def __init__(self, url: str, ttl: int = 1) -> None:
        """`ttl` is how many routers a multicast may pass, plus one."""
        parts = urlsplit(url)
        self._host, self._port, self._ttl = parts.hostname or "", parts.port or 0, ttl
        self._socket: socket.socket | None = None
        self._address: tuple[object, ...] = ()

    def send(self, data: bytes) -> None:
        """Send one datagram; raises OSError."""
        if self._socket is None:
            self._open()
        assert self._socket is not None
        try:
            self._socket.sendto(data, self._address)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _open(self) -> None:
        found = socket.getaddrinfo(self._host, self._port, type=socket.SOCK_DGRAM)
        family, kind, protocol, _, self._address = found[0]
        self._socket = socket.socket(family, kind, protocol)
        if not ipaddress.ip_address(str(self._address[0]).split("%")[0]).is_multicast:
            return
        if family == socket.AF_INET6:
            self._socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, self._ttl)
        else:
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, self._ttl)


class Stream:
    """Sends to tcp:// or tls://host:port over one connection, made anew when it breaks."""

    def __init__(
        self, url: str, context: ssl.SSLContext | None = None, server_name: str | None = None
    ) -> None:
        """With a context the stream speaks TLS; `server_name` is what its certificate names."""
        parts = urlsplit(url)
        self._host, self._port = parts.hostname or "", parts.port or 0
        self._context, self._server_name = context, server_name or self._host
        self._socket: socket.socket | None = None

    def send(self, data: bytes) -> None:
        """Send all of `data`; raises OSError."""
        try:
            if self._socket is not None and self._has_ended(self._socket):
                self.close()
            if self._socket is None:
                self._socket = self._open()
            self._socket.sendall(data)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _open(self) -> socket.socket:
        opened = socket.create_connection((self._host, self._port), TIMEOUT_S)
        if self._context is None:
            return opened
        try:
            return self._context.wrap_socket(opened, server_hostname=self._server_name)
        except ssl.SSLError as error:
            opened.close()
            raise OSError(f"{self._host}: TLS failed ({error.reason or error})") from None

    @staticmethod
    def _has_ended(opened: socket.socket) -> bool:
        """Throw away what the peer says, which would fill its buffers; true where it has closed."""
        opened.settimeout(0.0)
        try:
            for _ in range(16):
                if not opened.recv(CHUNK):
                    return True
        except (BlockingIOError, ssl.SSLWantReadError):
            return False
        except OSError:
            return True
        finally:
            opened.settimeout(TIMEOUT_S)
        return False
