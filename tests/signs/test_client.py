"""The client and the simulated sign over real UDP: the sequence, its refusals, hostile signs."""

from __future__ import annotations

import asyncio
import importlib.util
import logging
import random
import re
import shutil
import socket
import subprocess
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, TypeVar

import pytest
from between import Relay
from pydantic import SecretStr

from queuetail.errors import InputError
from queuetail.signs import ntcip
from queuetail.signs.agent import SignAgent
from queuetail.signs.client import Overtaken, Shown, SignClient
from queuetail.signs.faults import SignFault, SignSilent
from queuetail.signs.ntcip import Column, ControlMode, Memory, Source, cell
from queuetail.signs.secrets import Secrets
from queuetail.signs.simulated import SimulatedSign
from queuetail.signs.snmp import Session, split_address

T = TypeVar("T")
TWO = (("STOPPED", "TRAFFIC", "1/2 MILE"), ("PREPARE", "TO STOP"))
WORK = (("ROAD", "WORK", "AHEAD"),)


@pytest.fixture
def agent() -> Iterator[SignAgent]:
    with SignAgent() as running:
        yield running


def with_client(
    address: str, use: Callable[[SignClient], Coroutine[Any, Any, T]], **session: Any
) -> T:
    """Run one task of a client in an event loop of its own."""

    async def task() -> T:
        client = SignClient(Session(address, session.pop("secrets", Secrets()), **session))
        try:
            return await use(client)
        finally:
            client.close()

    return asyncio.run(task())


def test_a_message_is_shown_refreshed_and_blanked(agent: SignAgent) -> None:
    async def use(client: SignClient) -> list[Shown]:
        await client.prepare(WORK, 2)
        shown = [await client.show(TWO, 1), await client.show(TWO, 1)]
        return [
            *shown,
            await client.show((), 1),
            await client.show_default(),
            await client.status(),
        ]

    first, second, blank, default, status = with_client(agent.address, use)
    assert first.phases == second.phases == TWO
    assert (first.source, first.minutes_left) == (Source.CENTRAL, 1)
    assert blank.phases == ()
    assert default.phases == WORK
    assert status == default
    assert agent.phases() == WORK
    for oid in (ntcip.END_DURATION_MESSAGE, ntcip.COMM_LOSS_MESSAGE, ntcip.LONG_POWER_MESSAGE):
        assert agent.sign.get(oid) == default.message.encode()
    assert agent.sign.get(ntcip.COMM_LOSS_MINUTES) == 2
    assert agent.sign.get(cell(Column.OWNER, Memory.CHANGEABLE, 1)) == b"queuetail"


def test_a_refresh_does_not_write_the_message_again(agent: SignAgent) -> None:
    with Relay(agent.address) as relay:

        async def use(client: SignClient) -> tuple[int, int]:
            await client.show(TWO, 1)
            first = len(relay.requests)
            await client.show(TWO, 1)
            return first, len(relay.requests) - first

        first, second = with_client(relay.address, use)
    assert second <= 4 < first


def test_a_message_that_somebody_changed_in_the_sign_is_written_anew(agent: SignAgent) -> None:
    async def use(client: SignClient) -> Shown:
        await client.prepare(WORK, 1)
        await client.show(TWO, 1)
        agent.sign._rows[Memory.CHANGEABLE, 1].multi = b"EVIL"
        with pytest.raises(Overtaken):
            await client.show(TWO, 1)
        assert not client.is_prepared
        return await client.show(TWO, 1)

    assert with_client(agent.address, use).phases == TWO


def test_a_sign_that_hears_nothing_more_goes_to_its_default() -> None:
    """A minute passes in 0.6 s."""
    with SignAgent(clock_factor=100.0) as agent:

        async def use(client: SignClient) -> None:
            await client.prepare(WORK, 2)
            await client.show(TWO, 1)

        with_client(agent.address, use)
        assert wait_until(lambda: agent.phases() == WORK)
        assert agent.sign.source == Source.END_DURATION
        assert wait_until(lambda: agent.sign.source == Source.COMM_LOSS)
        assert agent.phases() == WORK


def wait_until(done: Callable[[], bool], seconds: float = 10.0) -> bool:
    async def wait() -> bool:
        for _ in range(int(seconds / 0.02)):
            if done():
                return True
            await asyncio.sleep(0.02)
        return False

    return asyncio.run(wait())


def refusal(agent: SignAgent, use: Callable[[SignClient], Coroutine[Any, Any, object]]) -> str:
    with pytest.raises(SignFault) as refused:
        with_client(agent.address, use)
    text = str(refused.value)
    assert "\n" not in text
    return text


def test_refusals_are_sentences(agent: SignAgent) -> None:
    wide = (("SLOW TRAFFIC",),)
    assert "larger than its face" in refusal(agent, lambda c: c.show(wide, 1))
    assert "so many pages" in refusal(agent, lambda c: c.show((*TWO, *WORK), 1))
    agent.sign.control_mode = ControlMode.LOCAL
    assert "switched to local control" in refusal(agent, lambda c: c.show(TWO, 1))
    assert "switched to local control" in refusal(agent, lambda c: c.prepare(WORK, 1))
    agent.sign.control_mode = ControlMode.CENTRAL
    agent.sign.current.priority = 200
    assert "higher priority" in refusal(agent, lambda c: c.show(TWO, 1))
    assert agent.phases() == ()


@pytest.mark.parametrize(
    ("break_", "sentence"),
    [
        ("crc", "its checksum is 1"),
        ("activate", "the unknown error 42"),
        ("show", "accepted the message but shows (blank)"),
        ("status", "did not let a message be changed in time"),
    ],
)
def test_a_sign_that_does_not_do_what_it_should(
    break_: str, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("queuetail.signs.client.POLLS", 2)

    class Broken(SimulatedSign):
        def get(self, oid: ntcip.Oid) -> int | bytes:
            if break_ == "crc" and oid == cell(Column.CRC, Memory.CHANGEABLE, 1):
                return 1
            if break_ == "activate" and oid == ntcip.ACTIVATE_ERROR:
                return 42
            if break_ == "status" and oid == cell(Column.STATUS, Memory.CHANGEABLE, 1):
                return 1
            return super().get(oid)

        def _activation_error(self, code: ntcip.Activation) -> int:
            return 42 if break_ == "activate" else super()._activation_error(code)

        def _show(self, message: ntcip.MessageId, source: Source, minutes: int) -> None:
            if break_ != "show":
                super()._show(message, source, minutes)

    with SignAgent(Broken()) as agent:
        assert sentence in refusal(agent, lambda c: c.show(TWO, 1))


def test_a_version_4_sign_without_the_old_activation_and_without_beacons() -> None:
    class Version4(SimulatedSign):
        def set(self, oid: ntcip.Oid, value: int | bytes) -> None:
            absent = (Column.BEACON, Column.PIXEL_SERVICE, Column.OWNER)
            in_table = oid[: len(ntcip.MESSAGE_ENTRY)] == ntcip.MESSAGE_ENTRY
            if oid == ntcip.ACTIVATE_MESSAGE or (in_table and oid[-3] in absent):
                self.get((1, 3))
            super().set(oid, value)

    with SignAgent(Version4()) as agent:
        assert with_client(agent.address, lambda c: c.show(TWO, 1)).phases == TWO


@pytest.mark.parametrize("timeout_s", [0.2])
def test_a_silent_sign_and_a_wrong_community_say_what_to_check(
    agent: SignAgent, timeout_s: float
) -> None:
    quick = {"timeout_s": timeout_s, "retries": 0}
    with pytest.raises(SignSilent, match="check its address, its power, the link"):
        with_client("127.0.0.1:9", lambda c: c.status(), **quick)
    wrong = Secrets(community=SecretStr("hush-hush"))
    with pytest.raises(SignSilent, match="community") as silent:
        with_client(agent.address, lambda c: c.status(), secrets=wrong, **quick)
    assert "hush" not in str(silent.value)
    with pytest.raises(SignSilent, match="cannot be looked up"):
        with_client("no-such-host.invalid", lambda c: c.status(), **quick)


USER = Secrets(user="queuetail", auth_key=SecretStr("long enough key"))
PRIVATE = Secrets(
    user="queuetail", auth_key=SecretStr("long enough key"), priv_key=SecretStr("another long key")
)


@pytest.mark.parametrize("auth", ["md5", "sha", "sha512"])
def test_snmp_v3_with_every_kind_of_key(auth: str) -> None:
    secrets = USER.model_copy(update={"auth": auth})
    with SignAgent(secrets=secrets) as agent:
        assert with_client(agent.address, lambda c: c.status(), secrets=secrets).phases == ()


def test_snmp_v3_with_a_user_and_with_strangers() -> None:
    secrets = USER
    with SignAgent(secrets=secrets) as agent:
        shown = with_client(agent.address, lambda c: c.show(TWO, 1), secrets=secrets)
        assert shown.phases == TWO
        quick = {"timeout_s": 1.0, "retries": 0}
        other = secrets.model_copy(update={"auth_key": SecretStr("some other key")})
        with pytest.raises(SignSilent, match="auth_key is wrong"):
            with_client(agent.address, lambda c: c.show((), 1), secrets=other, **quick)
        stranger = secrets.model_copy(update={"user": "stranger"})
        with pytest.raises(SignSilent, match="does not know the SNMPv3 user"):
            with_client(agent.address, lambda c: c.show((), 1), secrets=stranger, **quick)
        unsigned = Secrets(user="queuetail")
        with pytest.raises(SignFault):
            with_client(agent.address, lambda c: c.show((), 1), secrets=unsigned, **quick)
        with pytest.raises(SignSilent):
            with_client(agent.address, lambda c: c.show((), 1), **quick)
        assert agent.phases() == TWO


def test_snmp_v3_with_encryption() -> None:
    if importlib.util.find_spec("cryptography") is None:
        with pytest.raises(InputError, match="package cryptography"):
            Session("127.0.0.1", PRIVATE)
        with pytest.raises(InputError, match="package cryptography"):
            SignAgent(secrets=PRIVATE)
        pytest.skip("the package cryptography is not installed")
    with SignAgent(secrets=PRIVATE) as agent, Relay(agent.address) as relay:
        shown = with_client(relay.address, lambda c: c.show(TWO, 1), secrets=PRIVATE)
        assert shown.phases == TWO
        assert not any(b"STOPPED" in request for request in relay.requests)


# Hostile signs


def mutations(answer: bytes, rng: random.Random) -> list[bytes]:
    """Return one kind of harm done to an answer."""
    changed = bytearray(answer)
    for _ in range(rng.randrange(1, 6)):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    kinds = (
        [rng.randbytes(rng.randrange(200))],
        [answer[: rng.randrange(len(answer))]],
        [rng.randbytes(60_000), answer],
        [b"\x30\x80" * 20_000],
        [b"\x30\x84\x7f\xff\xff\xff" + answer],
        [answer] * 50,
        [bytes(changed)],
        [bytes(changed)],
    )
    return rng.choice(kinds)


def test_a_fuzzed_answer_does_no_harm(
    agent: SignAgent, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    """Twenty sessions with signs whose answers are broken: each ends, right or told why."""
    agent.sign.current.multi = b"[jp3]HELLO"

    async def one(address: str) -> object:
        client = SignClient(Session(address, Secrets(), timeout_s=0.3, retries=0))
        try:
            return await asyncio.wait_for(client.status(), 20.0)
        except SignFault as fault:
            return fault
        finally:
            client.close()

    async def some(seed: int) -> list[object]:
        rng = random.Random(seed)
        with Relay(agent.address, lambda answer: mutations(answer, rng)) as relay:
            return [await one(relay.address) for _ in range(4)]

    async def all_of_them() -> list[list[object]]:
        return await asyncio.gather(*(some(seed) for seed in range(5)))

    found = [each for several in asyncio.run(all_of_them()) for each in several]
    faults = [str(f) for f in found if isinstance(f, SignFault)]
    assert len(faults) > 5
    assert len(found) == 20
    assert all("\n" not in sentence and len(sentence) < 300 for sentence in faults)
    assert not [r for r in caplog.records if r.levelno >= logging.ERROR]
    assert "Traceback" not in capfd.readouterr().err


def test_hostile_requests_do_not_stop_the_simulated_sign(agent: SignAgent) -> None:
    rng = random.Random(3)
    with (
        Relay(agent.address) as relay,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker,
    ):
        with_client(relay.address, lambda c: c.show(TWO, 1))
        for request in relay.requests:
            for each in mutations(request, rng):
                attacker.sendto(each, ("127.0.0.1", agent.port))
    assert with_client(agent.address, lambda c: c.status()).control_mode == ControlMode.CENTRAL


def test_an_answer_from_somebody_else_is_not_heard(agent: SignAgent) -> None:
    """A true answer, but sent from another port than was asked."""
    with Relay(agent.address) as relay:

        def from_elsewhere(answer: bytes) -> list[bytes]:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
                other.sendto(answer, relay._client)
            return []

        relay.change = from_elsewhere
        with pytest.raises(SignSilent):
            with_client(relay.address, lambda c: c.status(), timeout_s=0.3, retries=0)


def test_a_message_that_is_overtaken_is_not_activated(agent: SignAgent) -> None:
    async def use(client: SignClient) -> None:
        for phases in (TWO, ()):
            with pytest.raises(Overtaken):
                await client.show(phases, 1, lambda: False)

    with_client(agent.address, use)
    assert agent.sign.activations == 0


def test_a_flood_does_not_keep_the_client(agent: SignAgent) -> None:
    flood = [bytes([n % 256]) * 500 for n in range(3000)]
    with Relay(agent.address, lambda answer: flood) as relay:
        quick = {"timeout_s": 0.3, "retries": 0}
        with pytest.raises(SignSilent):
            with_client(relay.address, lambda c: c.status(), **quick)


@pytest.mark.parametrize(
    ("oid", "value"),
    [
        (ntcip.SOURCE_MODE, b"text"),
        (cell(Column.MULTI, Memory.CURRENT, 1), 7),
        (cell(Column.MULTI, Memory.CURRENT, 1), b"A" * 5000),
        (ntcip.MESSAGE_SOURCE, b"too long a code"),
        (ntcip.TIME_REMAINING, b""),
    ],
)
def test_answers_of_the_wrong_kind_are_refused(oid: ntcip.Oid, value: int | bytes) -> None:
    class Odd(SimulatedSign):
        def get(self, asked: ntcip.Oid) -> int | bytes:
            return value if asked == oid else super().get(asked)

    with SignAgent(Odd()) as agent, pytest.raises(SignSilent):
        with_client(agent.address, lambda c: c.status(), timeout_s=0.3, retries=0)


def test_a_text_that_is_no_multi_is_shown_as_it_is() -> None:
    class Odd(SimulatedSign):
        def get(self, asked: ntcip.Oid) -> int | bytes:
            own = asked == cell(Column.MULTI, Memory.CURRENT, 1)
            return b"[\xff\x00" if own else super().get(asked)

    with SignAgent(Odd()) as agent:
        assert with_client(agent.address, lambda c: c.status()).phases == (("[\ufffd\x00",),)


@pytest.mark.parametrize(
    ("address", "split"),
    [
        ("sign", ("sign", 161)),
        ("10.0.0.5:1161", ("10.0.0.5", 1161)),
        ("[::1]:1161", ("::1", 1161)),
        ("::1", ("::1", 161)),
    ],
)
def test_addresses(address: str, split: tuple[str, int]) -> None:
    assert split_address(address) == split


@pytest.mark.parametrize(
    "address",
    ["", "sign:", "sign:x", ":161", "sign:0", "sign:70000", "http://sign:161", "a sign", "sign/1"],
)
def test_addresses_that_are_none(address: str) -> None:
    with pytest.raises(InputError, match="no address of a sign"):
        split_address(address)


# Somebody else's SNMP


def snmp(program: str, agent: SignAgent, *arguments: str) -> str:
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed (Debian package snmp)")
    command = [program, "-v1", "-c", "public", "-t", "2", "-On", agent.address, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    return done.stdout + done.stderr


def dotted(oid: ntcip.Oid) -> str:
    return "." + ".".join(map(str, oid))


def test_net_snmp_drives_the_simulated_sign(agent: SignAgent) -> None:
    """The whole sequence with Debian's snmpset and snmpget."""
    row = Memory.CHANGEABLE, 3
    status = dotted(cell(Column.STATUS, *row))
    assert "INTEGER: 4" in snmp("snmpget", agent, dotted(ntcip.CONTROL_MODE))
    assert "INTEGER: 6" in snmp("snmpset", agent, status, "i", "6")
    snmp(
        *("snmpset", agent),
        *(dotted(cell(Column.MULTI, *row)), "s", "[jl3]HELLO"),
        *(dotted(cell(Column.BEACON, *row)), "i", "0"),
        *(dotted(cell(Column.PIXEL_SERVICE, *row)), "i", "0"),
    )
    snmp("snmpset", agent, status, "i", "7")
    assert "INTEGER: 4" in snmp("snmpget", agent, status)
    crc = ntcip.crc(b"[jl3]HELLO")
    assert f"INTEGER: {crc}" in snmp("snmpget", agent, dotted(cell(Column.CRC, *row)))
    message = ntcip.MessageId(*row, crc)
    code = ntcip.Activation(5, 50, message).encode().hex()
    snmp("snmpset", agent, dotted(ntcip.ACTIVATE_MESSAGE), "x", code)
    assert agent.phases() == (("HELLO",),)
    current = snmp("snmpget", agent, dotted(cell(Column.MULTI, Memory.CURRENT, 1)))
    assert '"[jl3]HELLO"' in current
    wrong = ntcip.Activation(5, 50, ntcip.MessageId(*row, 1)).encode().hex()
    refused = snmp("snmpset", agent, dotted(ntcip.ACTIVATE_MESSAGE), "x", wrong)
    assert "genError" in refused or "General" in refused
    assert "INTEGER: 7" in snmp("snmpget", agent, dotted(ntcip.ACTIVATE_ERROR))
    assert "noSuchName" in snmp("snmpget", agent, dotted((*ntcip.DMS, 99, 0)))


def test_net_snmp_walks_the_simulated_sign(agent: SignAgent) -> None:
    lines = snmp("snmpwalk", agent, dotted(ntcip.DMS)).splitlines()
    named = [line for line in lines if re.match(r"^\.1\.3\.6\.1\.4\.1\.1206", line)]
    assert len(named) == len(agent.sign.names())
