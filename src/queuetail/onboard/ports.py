"""Byte streams to sensors and radios: serial lines, UDP and TCP behind one small interface."""

from __future__ import annotations

import errno
import os
import re
import socket
import stat
from typing import Protocol

from queuetail.errors import InputError
from queuetail.onboard.source import POLL_S

LARGEST_DATAGRAM = 65_535
DRAINED_BYTES = 4_096
CONNECT_S = 3.0
HIGHEST_PORT = 65_535


class Port(Protocol):
    """What is read and written; every method raises OSError when the connection is gone."""

    def read(self) -> bytes:
        """Return what came within a fifth of a second, perhaps nothing."""
        ...

    def write(self, data: bytes) -> None:
        """Send the bytes, as far as there is somebody to send them to."""
        ...

    def close(self) -> None:
        """Free the device or socket."""
        ...


class SerialPort:
    """A serial device; an unplugged one raises OSError."""

    def __init__(self, device: str, baud: int, read_timeout_s: float = POLL_S) -> None:
        import serial  # type: ignore[import-untyped]  # noqa: PLC0415

        try:
            self._serial = serial.Serial(
                device, baud, timeout=read_timeout_s, write_timeout=1.0, exclusive=True
            )
        except serial.SerialException as error:
            raise OSError(f"{device}: {_why_closed(error)}") from None

    def read(self) -> bytes:
        """Return all that is there, waiting a moment for the first byte."""
        first = self._serial.read(1)
        if not first:
            return b""
        return bytes(first + self._serial.read(min(self._serial.in_waiting, DRAINED_BYTES)))

    def write(self, data: bytes) -> None:
        """Send the bytes."""
        self._serial.write(data)

    @property
    def waiting_bytes(self) -> int:
        """How many written bytes the driver still holds."""
        return int(self._serial.out_waiting)

    def close(self) -> None:
        """Close the device."""
        self._serial.close()


class UdpPort:
    """A UDP socket: bound, and then answering who spoke last; or speaking first to an address."""

    def __init__(self, host: str, port: int, is_bound: bool) -> None:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0][0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._peer: tuple[str, int] | None = None if is_bound else (host, port)
        self._socket.settimeout(POLL_S)
        try:
            if is_bound:
                self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise

    def read(self) -> bytes:
        """Return one datagram, or nothing."""
        try:
            data, peer = self._socket.recvfrom(LARGEST_DATAGRAM)
        except TimeoutError:
            return b""
        except ConnectionRefusedError:  # an earlier datagram of ours found nobody yet
            return b""
        self._peer = peer
        return data

    def write(self, data: bytes) -> None:
        """Send a datagram to the peer, where one is known and there."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(data, self._peer)
        except OSError as error:
            if error.errno not in (errno.ECONNREFUSED, errno.ENETUNREACH, errno.EHOSTUNREACH):
                raise

    @property
    def port(self) -> int:
        """The local port number."""
        return int(self._socket.getsockname()[1])

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpPort:
    """A TCP connection to a server."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        self._socket.settimeout(POLL_S)

    def read(self) -> bytes:
        """Return what came, or nothing; raises ConnectionError at the end of the stream."""
        try:
            data = self._socket.recv(LARGEST_DATAGRAM)
        except TimeoutError:
            return b""
        if not data:
            raise ConnectionError("the other end closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send the bytes."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def split_device(text: str, default_baud: int) -> tuple[str, int]:
    """Split DEVICE[:BAUD]; raises InputError where the baud rate is none."""
    device, colon, baud = text.rpartition(":")
    if not colon:
        return serial_line(text), default_baud
    if not baud.isdigit() or not device:
        raise InputError(
            f"'{text}' is not a serial line; write the device and its baud rate as "
            f"/dev/ttyUSB0:{default_baud}"
        )
    return serial_line(device), int(baud)


def serial_line(device: str) -> str:
    """Return the device; raises InputError where it cannot be a serial line.

    One that is not there is none of these: it may be plugged in later.
    """
    try:
        is_device = stat.S_ISCHR(os.stat(device).st_mode)
    except OSError:
        if os.sep in device or re.fullmatch(r"COM\d+", device, re.IGNORECASE):
            return device
        raise InputError(
            f"'{device}' is no serial line; write a device such as /dev/ttyUSB0"
        ) from None
    try:
        opened = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK) if is_device else -1
    except PermissionError:
        raise InputError(
            f"{device} may not be used by this user; join the group that owns it (on Debian: "
            "sudo adduser $USER dialout) and log in again"
        ) from None
    except OSError:
        return device  # taken, or just being unplugged: it is tried again
    try:
        if opened < 0 or not os.isatty(opened):
            raise InputError(f"{device} is no serial line; write a device such as /dev/ttyUSB0")
    finally:
        if opened >= 0:
            os.close(opened)
    return device


def _why_closed(error: OSError) -> str:
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return "another program has it open"
    return os.strerror(error.errno) if error.errno else str(error)


def split_address(text: str, example: str) -> tuple[str, int]:
    """Split HOST:PORT; raises InputError showing the example."""
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdigit() or not 0 < int(port) <= HIGHEST_PORT:
        raise InputError(f"'{text}' is no address with a port; write it as {example}")
    return host.strip("[]") or "0.0.0.0", int(port)
