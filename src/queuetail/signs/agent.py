"""A simulated sign on the network: a real SNMP agent (v1, v2c, v3) for tests and for training."""

from __future__ import annotations

import asyncio
import importlib
import socket
from threading import Event, Lock, Thread
from time import monotonic
from types import TracebackType
from typing import Any

from queuetail.errors import InputError
from queuetail.signs import face
from queuetail.signs.faults import SNMP_ERRORS
from queuetail.signs.guarded import guarded
from queuetail.signs.ntcip import DMS, Oid
from queuetail.signs.records import Phases
from queuetail.signs.secrets import Secrets
from queuetail.signs.simulated import Refused, SimulatedSign, Value
from queuetail.signs.snmp import user_keys

TICK_S = 0.05
START_S = 10.0


class SignAgent:
    """A simulated sign that answers SNMP on a UDP port, in a thread of its own.

    `clock_factor` makes its minutes pass faster: tests need not wait for a duration to end.
    """

    def __init__(
        self,
        sign: SimulatedSign | None = None,
        port: int = 0,
        *,
        host: str = "127.0.0.1",
        secrets: Secrets | None = None,
        clock_factor: float = 1.0,
    ) -> None:
        """Start answering; port 0 takes a free one.  Raises InputError when the port is taken."""
        self.sign = sign if sign is not None else SimulatedSign()
        self._secrets = secrets if secrets is not None else Secrets()
        self._clock_factor, self._zero_s = clock_factor, monotonic()
        self._lock = Lock()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise InputError(
                f"the simulated sign cannot listen on {host}:{port} ({error.strerror})"
            ) from None
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self.address = f"{host}:{self.port}"
        self._loop = asyncio.new_event_loop()
        self._started = Event()
        self._fault: Exception | None = None
        self._stop = asyncio.Event()
        self._thread = Thread(target=self._work, name="simulated sign", daemon=True)
        self._thread.start()
        self._started.wait(START_S)
        if self._fault is not None:
            self._socket.close()
            raise self._fault

    def __enter__(self) -> SignAgent:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def alive(self) -> bool:
        """Whether it still answers."""
        return self._thread.is_alive()

    def close(self) -> None:
        """Stop answering and release the port."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join(START_S)

    def phases(self) -> Phases:
        """Return the words on the sign now; none when it is blank."""
        with self._lock:
            self._tick()
            pages = self.sign.pages_shown()
            return tuple(tuple(line.text for line in page.lines) for page in pages)

    def text(self) -> str:
        """Return the face as it is lit just now, as lines of text in a frame."""
        with self._lock:
            self._tick()
            return face.as_text(self.sign.page_shown(), self.sign.lines, self.sign.characters)

    def face_png(self) -> bytes:
        """Return the face as it is lit just now, as a PNG picture of amber diodes."""
        with self._lock:
            self._tick()
            page, size = self.sign.page_shown(), (self.sign.lines, self.sign.characters)
        return face.png(page, *size)

    # What the SNMP engine calls, in the agent's thread

    def read(self, oid: Oid) -> Value:
        """Return an object's value; raises Refused."""
        with self._lock:
            self._tick()
            self.sign.heard()
            return self.sign.get(oid)

    def after(self, oid: Oid) -> Oid | None:
        """Return the name of the object that follows, for walks."""
        with self._lock:
            return next((name for name in self.sign.names() if name > oid), None)

    def write(self, pairs: list[tuple[Oid, Value]]) -> None:
        """Set objects; raises Refused."""
        with self._lock:
            self._tick()
            self.sign.heard()
            self.sign.set_all(pairs)

    def _tick(self) -> None:
        self.sign.tick((monotonic() - self._zero_s) * self._clock_factor)

    def _work(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            try:
                runner.run(self._serve())
            except Exception as error:  # handed to whoever started the sign
                self._fault = error
                self._started.set()

    async def _serve(self) -> None:
        engine = _engine(self, self._socket, self._secrets)
        await asyncio.sleep(0)  # lets the transport open
        self._started.set()
        while not self._stop.is_set():
            with self._lock:
                self._tick()
            try:
                await asyncio.wait_for(self._stop.wait(), TICK_S)
            except TimeoutError:
                continue
        engine.close_dispatcher()
        await asyncio.sleep(0)


def _engine(agent: SignAgent, bound: socket.socket, secrets: Secrets) -> Any:
    """Return a pysnmp engine that answers on the socket for the agent."""
    try:
        config = importlib.import_module("pysnmp.entity.config")
        engine = importlib.import_module("pysnmp.entity.engine").SnmpEngine()
        cmdrsp = importlib.import_module("pysnmp.entity.rfc3413.cmdrsp")
        contexts = importlib.import_module("pysnmp.entity.rfc3413.context")
        udp = importlib.import_module("pysnmp.carrier.asyncio.dgram.udp")
    except ImportError:
        raise InputError(
            "a simulated sign needs the package pysnmp; install the extra: "
            "pip install 'queuetail[signs]'"
        ) from None
    transport = guarded(udp.UdpTransport)().open_server_mode(sock=bound)
    config.add_transport(engine, udp.DOMAIN_NAME, transport)
    if secrets.user is None:
        community = secrets.community.get_secret_value() if secrets.community else "public"
        config.add_v1_system(engine, "sign", community)
        for model in (1, 2):
            config.add_vacm_user(engine, model, "sign", "noAuthNoPriv", DMS, DMS)
    else:
        level, keys = user_keys(secrets)
        config.add_v3_user(engine, secrets.user, **keys)
        config.add_vacm_user(engine, 3, secrets.user, level, DMS, DMS)
    context = contexts.SnmpContext(engine)
    context.unregister_context_name(b"")
    context.register_context_name(b"", _instrumentation(agent))
    for responder in ("Get", "Next", "Set", "Bulk"):
        getattr(cmdrsp, f"{responder}CommandResponder")(engine, context)
    return engine


def _instrumentation(agent: SignAgent) -> Any:
    """Return what pysnmp asks for objects: it hands them on to the agent."""
    instrum = importlib.import_module("pysnmp.smi.instrum")
    smi_error = importlib.import_module("pysnmp.smi.error")
    rfc1902 = importlib.import_module("pysnmp.proto.rfc1902")
    rfc1905 = importlib.import_module("pysnmp.proto.rfc1905")
    # NO_SUCH has no class for SNMPv2, but an exceptional value.
    errors = {
        **{3: smi_error.BadValueError, 5: smi_error.GenError, 7: smi_error.WrongTypeError},
        **{8: smi_error.WrongLengthError, 10: smi_error.WrongValueError},
        **{12: smi_error.InconsistentValueError, 17: smi_error.NotWritableError},
    }
    assert errors.keys() <= SNMP_ERRORS.keys()

    def encoded(value: Value) -> Any:
        kind = rfc1902.Integer32 if isinstance(value, int) else rfc1902.OctetString
        return kind(value)

    def plain(value: Any) -> Value:
        return bytes(value) if isinstance(value, rfc1902.OctetString) else int(value)

    class Instrumentation(instrum.AbstractMibInstrumController):  # type: ignore[misc, name-defined]
        """Reads, walks and writes the sign's objects."""

        def read_variables(self, *pairs: Any, **context: Any) -> list[Any]:
            return [(name, self._read(tuple(name))) for name, _ in pairs]

        def _read(self, oid: Oid) -> Any:
            try:
                return encoded(agent.read(oid))
            except Refused:
                return rfc1905.noSuchInstance

        def read_next_variables(self, *pairs: Any, **context: Any) -> list[Any]:
            found = []
            for name, _ in pairs:
                following = agent.after(tuple(name))
                if following is None:
                    found.append((name, rfc1905.endOfMibView))
                else:
                    found.append((rfc1902.ObjectName(following), self._read(following)))
            return found

        def write_variables(self, *pairs: Any, **context: Any) -> list[Any]:
            allowed = context.get("acFun")
            for index, (name, value) in enumerate(pairs):
                if allowed is not None and allowed("write", (name, value), idx=index, **context):
                    raise smi_error.NotWritableError(name=name, idx=index)
            try:
                agent.write([(tuple(name), plain(value)) for name, value in pairs])
            except (TypeError, ValueError):
                raise smi_error.WrongTypeError(name=pairs[0][0], idx=0) from None
            except Refused as refused:
                kind = errors.get(refused.status, smi_error.NoCreationError)
                raise kind(name=pairs[refused.index][0], idx=refused.index) from None
            return list(pairs)

    return Instrumentation()
