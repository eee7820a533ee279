"""MCAP: every reader takes our files, also after a cut at any byte."""

from __future__ import annotations

import json
import random
from pathlib import Path

import jsonschema
import pytest
from mcap.reader import make_reader

from queuetail.live.mcap_file import McapFile, is_finished, read_mcap, repair
from queuetail.live.mcap_records import Message
from queuetail.live.mcap_schemas import TOPICS, schema_of
from queuetail.types import Observation

COUNT = 60


def message(k: int) -> Message:
    return Message("/log", 1_000_000_000 * k, {"message": f"number {k}", "level": 2})


@pytest.fixture
def chunked(tmp_path: Path) -> Path:
    """A file of a few messages in each chunk, without its end."""
    path = tmp_path / "cut.mcap"
    writer = McapFile(path)
    for k in range(COUNT):
        writer.write(message(k))
        if k % 5 == 4:
            writer.flush()
    return path


def test_what_was_flushed_is_read_without_an_end(chunked: Path) -> None:
    assert not is_finished(chunked)
    assert list(read_mcap(chunked)) == [message(k) for k in range(COUNT)]


def test_a_cut_at_any_byte_keeps_every_whole_chunk(chunked: Path, tmp_path: Path) -> None:
    whole = chunked.read_bytes()
    path = tmp_path / "part.mcap"
    kept = []
    for size in [*range(0, len(whole), 97), len(whole)]:
        path.write_bytes(whole[:size])
        found = list(read_mcap(path))
        assert found == [message(k) for k in range(len(found))]
        assert len(found) % 5 == 0
        kept.append(len(found))
    assert kept == sorted(kept)
    assert kept[-1] == COUNT


def test_zeros_after_a_power_cut_are_no_messages(chunked: Path) -> None:
    with chunked.open("ab") as file:
        file.write(bytes(5000))
    assert len(list(read_mcap(chunked))) == COUNT
    assert repair(chunked)
    assert len(list(read_mcap(chunked))) == COUNT


def test_damage_is_never_read_as_a_value(chunked: Path) -> None:
    whole = chunked.read_bytes()
    true = [message(k) for k in range(COUNT)]
    rng = random.Random(5)
    for _ in range(200):
        damaged = bytearray(whole)
        damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
        chunked.write_bytes(damaged)
        found = list(read_mcap(chunked))
        assert all(m in true for m in found)


def test_a_repaired_file_is_as_good_as_a_finished_one(chunked: Path) -> None:
    chunked.write_bytes(chunked.read_bytes()[:-200])
    assert repair(chunked)
    assert not repair(chunked)
    assert is_finished(chunked)
    with chunked.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == COUNT - 5
        assert [m.log_time for _, _, m in reader.iter_messages()][:2] == [0, 1_000_000_000]


def test_every_message_of_a_recording_fits_its_documented_schema(
    recorded: tuple[Path, list[Observation]],
) -> None:
    folder, answers = recorded
    seen: dict[str, int] = {}
    checks = {topic: jsonschema.Draft202012Validator(schema) for topic, schema in TOPICS.items()}
    for path in sorted(folder.glob("data-*.mcap")):
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            for schema, channel, found in reader.iter_messages():
                assert schema is not None
                assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                assert json.loads(schema.data) == schema_of(channel.topic)
                checks["/" + channel.topic.split("/")[1]].validate(json.loads(found.data))
                seen[channel.topic] = seen.get(channel.topic, 0) + 1
    assert seen["/frame"] == seen["/answer"] == seen["/camera"] == len(answers)
    assert {f"/{topic.split('/')[1]}" for topic in seen} >= set(TOPICS) - {"/eoq"}
    assert 4 <= seen["/health"] <= 7


def test_foxglove_knows_two_of_the_schemas() -> None:
    assert TOPICS["/eoq"]["title"] == "foxglove.LocationFix"
    assert TOPICS["/log"]["title"] == "foxglove.Log"
