"""The first seconds of the bundled flight, cut without encoding anew."""

from __future__ import annotations

from pathlib import Path

import av


def cut_flight(source: Path, out: Path, seconds: float) -> Path:
    """Copy the packets of `source` up to `seconds` into `out`."""
    with av.open(str(source)) as whole, av.open(str(out), "w") as part:
        stream = whole.streams.video[0]
        copy = part.add_stream_from_template(stream)
        assert stream.time_base is not None
        for packet in whole.demux(stream):
            if packet.dts is None or packet.dts * stream.time_base >= seconds:
                break
            packet.stream = copy
            part.mux(packet)
    return out
