"""UDP transports for pysnmp that hostile datagrams cannot break.

pysnmp decodes what arrives in the event loop's own callbacks, where pyasn1 may raise anything on
a malformed packet; here such a packet is dropped, as is one from a host that was not asked.
"""

from __future__ import annotations

import importlib
from typing import Any

LARGEST_OCTETS = 16_384  # more than any answer that is asked for


def guarded(kind: Any) -> Any:
    """Return a subclass of a pysnmp datagram transport that drops what it cannot understand."""

    class Guarded(kind):  # type: ignore[misc]
        """Hands on what comes from `peer` (from anybody where that is None) and makes sense."""

        peer: tuple[str, int] | None = None

        def datagram_received(self, datagram: bytes, address: Any) -> None:
            known = self.peer is None or tuple(address[:2]) == self.peer
            if known and len(datagram) <= LARGEST_OCTETS:
                self.loop.call_soon(self._understand, address, datagram)

        def error_received(self, error: OSError) -> None:
            """Ignore what a closed port answers: the request's own timeout tells."""

        def _understand(self, address: Any, datagram: bytes) -> None:
            try:
                self._callback_function(self, address, datagram)
            except Exception:  # whatever malformed packets make pyasn1 raise
                return

    return Guarded


def guarded_target(api: Any, is_v6: bool) -> Any:
    """Return pysnmp's class of a UDP peer, with a guarded transport."""
    name = "udp6.Udp6AsyncioTransport" if is_v6 else "udp.UdpAsyncioTransport"
    module, transport = name.split(".")
    carrier = importlib.import_module(f"pysnmp.carrier.asyncio.dgram.{module}")
    kind = api.Udp6TransportTarget if is_v6 else api.UdpTransportTarget

    class Target(kind):  # type: ignore[misc, valid-type]
        """A peer whose answers alone are heard."""

        PROTO_TRANSPORT = guarded(getattr(carrier, transport))

        def open_client_mode(self) -> Any:
            opened = super().open_client_mode()
            opened.peer = tuple(self.transport_address[:2])
            return opened

    return Target
