"""Posting to a web address that may be hostile: checked addresses, no redirects, limits.

The name is resolved once, every address that it has is checked, and the connection goes to what was
checked, so that a name cannot be pointed elsewhere in between.  Proxies of the environment are not
used.  What is answered is read up to a limit, and the whole exchange has a deadline.
"""

from __future__ import annotations

import http.client
import ipaddress
import socket
import ssl
from collections.abc import Mapping
from threading import Timer
from urllib.parse import urlsplit

from queuetail import __version__
from queuetail.feeds.settings import Posted
from queuetail.feeds.tls import tls_context
from queuetail.live.outlet import Undeliverable

LARGEST_ANSWER = 4096
MOST_ADDRESSES = 4  # each may take its time to refuse
ITEM_AT_FAULT = (400, 409, 413, 415, 422)  # another try would be answered the same
NAT64 = ipaddress.ip_network("64:ff9b::/96")
Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class Refused(Exception):  # noqa: N818 - it says what was not done
    """The address must not be posted to, or answers what is not acceptable."""


class Poster:
    """Posts to one address; for one thread."""

    def __init__(self, url: str, settings: Posted) -> None:
        """Check the address; raises InputError where its certificates cannot be read."""
        parts = urlsplit(url)
        self._is_https = parts.scheme == "https"
        self._host = parts.hostname or ""
        self._port = parts.port or (443 if self._is_https else 80)
        self._path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        self._settings = settings
        self._context = tls_context(settings.ca_file) if self._is_https else None

    def send(
        self, body: bytes, headers: Mapping[str, str], method: str = "POST", query: str = ""
    ) -> None:
        """Send once; raises Undeliverable for a fault of the item, anything else for the way's."""
        connection = _Connection(self._host, self._port, self._open(), self._context)
        # A peer that sends a byte now and then never runs into a timeout of the socket.
        deadline = Timer(self._settings.timeout_s, connection.cut)
        deadline.daemon = True
        deadline.start()
        try:
            said = {"User-Agent": f"queuetail/{__version__}", "Connection": "close"}
            target = self._path + (("&" if "?" in self._path else "?") + query if query else "")
            connection.request(method, target, body, {**said, **headers})
            answer = connection.getresponse()
            answer.read(LARGEST_ANSWER)
            status = answer.status
        except (OSError, http.client.HTTPException, ValueError) as error:
            if connection.is_cut:
                raise TimeoutError(f"{self._host} took too long to answer") from None
            if isinstance(error, OSError):
                raise
            raise OSError(f"{self._host} answers no HTTP ({type(error).__name__})") from None
        finally:
            deadline.cancel()
            connection.close()
        self._judge(status)

    def _judge(self, status: int) -> None:
        if 200 <= status < 300:
            return
        if 300 <= status < 400:
            raise Refused(f"{self._host} redirects ({status}), which is not followed")
        text = f"{self._host} answers {status} {http.client.responses.get(status, '')}".strip()
        if status in ITEM_AT_FAULT:
            raise Undeliverable(text)
        raise OSError(text)

    def _open(self) -> socket.socket:
        """Connect to the first address that answers, of those that are checked."""
        found = resolved(self._host, self._port)
        for address in found:
            reason = forbidden(address, self._settings.allow_private)
            if reason:
                raise Refused(f"{self._host} is {address}, {reason}")
        fault: OSError = OSError(f"{self._host} has no address")
        for address in found:
            try:
                return socket.create_connection(
                    (str(address), self._port), self._settings.timeout_s
                )
            except OSError as error:
                fault = error
        raise fault


class _Connection(http.client.HTTPConnection):
    """A connection over a socket that is open already."""

    def __init__(
        self, host: str, port: int, opened: socket.socket, context: ssl.SSLContext | None
    ) -> None:
        super().__init__(host, port)
        self._opened, self._context = opened, context
        self.is_cut = False

    def connect(self) -> None:
        """Take the socket, and speak TLS on it where that is asked for."""
        self.sock = self._opened
        if self._context is None:
            return
        try:
            self.sock = self._context.wrap_socket(
                self._opened, server_hostname=self.host, do_handshake_on_connect=False
            )
            self.sock.do_handshake()
        except ssl.SSLError as error:
            raise OSError(f"{self.host}: TLS failed ({error.reason or error})") from None

    def cut(self) -> None:
        """End whatever is going on, from another thread."""
        self.is_cut = True
        try:
            socket.socket.shutdown(self.sock or self._opened, socket.SHUT_RDWR)
        except OSError:
            return  # it has ended by itself

    def close(self) -> None:
        """Close both, whichever there is."""
        super().close()
        self._opened.close()


def resolved(host: str, port: int) -> tuple[Address, ...]:
    """Return the addresses of a host; raises OSError where it has none."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        raise OSError(f"{host} cannot be resolved") from None
    texts = dict.fromkeys(str(entry[4][0]).split("%")[0] for entry in found)
    return tuple(ipaddress.ip_address(text) for text in list(texts)[:MOST_ADDRESSES])


def forbidden(address: Address, allow_private: bool) -> str:
    """Return why an address must not be connected to; nothing where it may."""
    inner = _inner(address)
    if inner.is_multicast or inner.is_unspecified:
        return "no address of a host"
    if allow_private or inner.is_global:
        return ""
    return "an address of this machine or of a private network; allow_private = true permits it"


def _inner(address: Address) -> Address:
    """Return the IPv4 address that an IPv6 address stands for, where it does."""
    if isinstance(address, ipaddress.IPv4Address):
        return address
    if address in NAT64:
        return ipaddress.IPv4Address(int(address) & 0xFFFF_FFFF)
    teredo = address.teredo
    return address.ipv4_mapped or address.sixtofour or (teredo[1] if teredo else address)
