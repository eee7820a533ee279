"""MCAP files that survive a power cut: written in short whole chunks, read up to the last one.

Source: mcap.dev/spec.  A finished file ends with a summary, a footer and the magic; one that was
cut has none of them, and perhaps half a record at its end.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

from mcap.records import Channel, Footer
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from queuetail.live.mcap_records import Message
from queuetail.live.mcap_schemas import schema_of

PROFILE = ""  # none of the well-known ones: plain JSON with schemas
LIBRARY = "queuetail"
LARGEST_RECORD_BYTES = 256 * 1024 * 1024  # a length beyond this is damage, not data
JSON = "json"


class McapFile:
    """One MCAP file being written; nothing is sure to be on the disk before :meth:`flush`."""

    def __init__(self, path: Path) -> None:
        """Create the file; raises OSError, also where it exists already."""
        self.path = path
        self._file = path.open("xb")
        self._writer = Writer(self._file)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._writer.start(PROFILE, LIBRARY)

    def write(self, message: Message) -> None:
        """Add a message."""
        channel = self._channels.get(message.topic) or self._register(message.topic)
        time_ns = message.time_ns
        self._writer.add_message(channel, time_ns, message.data(), time_ns)

    def flush(self) -> None:
        """End the chunk and see to it that all is on the disk."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write the summary and close; a second call does nothing."""
        if not self._file.closed:
            try:
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                os.fsync(self._file.fileno())
            finally:
                self._file.close()

    def _register(self, topic: str) -> int:
        schema = schema_of(topic)
        title = str(schema["title"])
        if title not in self._schemas:
            body = json.dumps(schema).encode()
            self._schemas[title] = self._writer.register_schema(title, "jsonschema", body)
        self._channels[topic] = self._writer.register_channel(topic, JSON, self._schemas[title])
        return self._channels[topic]


def read_mcap(path: Path) -> Iterator[Message]:
    """Yield the messages of a file of ours in the order of writing, up to where it was cut."""
    channels: dict[int, str] = {}
    with path.open("rb") as file:
        reader = StreamReader(
            file, validate_crcs=True, record_size_limit=LARGEST_RECORD_BYTES
        ).records
        while True:
            try:
                record = next(reader, None)
                if isinstance(record, McapMessage):
                    topic = channels[record.channel_id]
                    message = Message(topic, record.log_time, json.loads(record.data))
            except Exception:  # damaged bytes raise whatever they like; what came before is whole
                return
            if record is None:
                return
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, McapMessage):
                yield message


def is_finished(path: Path) -> bool:
    """Return whether a file has its footer, so that every MCAP reader takes it."""
    with path.open("rb") as file:
        try:
            records = StreamReader(file, record_size_limit=LARGEST_RECORD_BYTES).records
            return any(isinstance(record, Footer) for record in records)
        except Exception:  # as above
            return False


def repair(path: Path) -> bool:
    """Finish a file that was cut: keep every whole chunk; return whether it needed that."""
    if is_finished(path):
        return False
    partial = path.with_suffix(".repairing")
    partial.unlink(missing_ok=True)
    mended = McapFile(partial)
    for message in read_mcap(path):
        mended.write(message)
    mended.close()
    partial.replace(path)
    return True
