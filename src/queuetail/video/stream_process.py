"""SRT through an ffmpeg process: the FFmpeg inside PyAV knows no SRT."""

from __future__ import annotations

import os
import shutil
import subprocess
from types import TracebackType

from queuetail.errors import InputError

STOP_S = 1.0


def find_ffmpeg() -> str:
    """Return the ffmpeg program; raises InputError, with the mend, where none is installed."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise InputError(
            "SRT needs the program ffmpeg, which is not installed here: install it "
            "(on Debian: apt install ffmpeg), or let the camera send RTSP or UDP"
        )
    return program


class SrtProcess:
    """An ffmpeg that receives SRT and passes the transport stream on, as it is, by a pipe."""

    def __init__(self, address: str) -> None:
        """Start it; ``url`` is then what PyAV opens."""
        self._process = subprocess.Popen(
            [
                find_ffmpeg(),
                *("-hide_banner", "-loglevel", "error", "-nostdin"),
                *("-probesize", "1000000", "-analyzeduration", "1000000", "-i", address),
                *("-map", "0", "-c", "copy", "-copy_unknown"),
                *("-flush_packets", "1", "-f", "mpegts", "pipe:1"),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # it may repeat the address, and with it a passphrase
        )
        assert self._process.stdout is not None
        self._end = os.dup(self._process.stdout.fileno())
        self._process.stdout.close()
        self.url = f"pipe:{self._end}"

    def __enter__(self) -> SrtProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()
        os.close(self._end)

    def stop(self) -> None:
        """End the process, which also ends whoever reads from it; safe from any thread."""
        self._process.terminate()
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
