"""SNMP with one sign, over UDP: v1 with a community, v3 with a user; typed, bounded, by pysnmp.

What a sign answers is checked before it is believed: right objects, right types, no longer than
the standard allows.  Anything else counts as no answer.
"""

from __future__ import annotations

import asyncio
import importlib
import importlib.util
import re
from collections.abc import Sequence
from typing import Any

from queuetail.errors import InputError
from queuetail.signs.faults import SignFault, SignSilent, snmp_sentence
from queuetail.signs.guarded import guarded_target
from queuetail.signs.ntcip import Oid
from queuetail.signs.secrets import Secrets

DEFAULT_PORT = 161
LONGEST_OCTETS = 4096  # a MULTI string has 2048 octets at most (MIB: MultiString)
SLACK_S = 2.0
HOST = re.compile(r"[0-9A-Za-z._:%-]{1,253}")  # a name, or an address of either version

Value = int | bytes


class SnmpRefused(SignFault):
    """The sign answered with an SNMP error; `status` is RFC 3416's, `index` counts from 1."""

    def __init__(self, status: int, index: int, what: str) -> None:
        super().__init__(snmp_sentence(status, what))
        self.status, self.index = status, index


def split_address(address: str) -> tuple[str, int]:
    """Return host and port of `host`, `host:port` or `[v6 address]:port`; raises InputError."""
    host, separator, port = address.rpartition(":")
    if not separator or (":" in host and not host.endswith("]")):
        host, port = address, str(DEFAULT_PORT)
    host = host.removeprefix("[").removesuffix("]")
    whole = HOST.fullmatch(host) is not None and port.isascii() and port.isdecimal()
    if not whole or not 0 < int(port) < 65536:
        raise InputError(f"'{address}' is no address of a sign; write it as host or host:port")
    return host, int(port)


class Session:
    """Requests to one sign, one at a time, in the running event loop."""

    def __init__(
        self, address: str, secrets: Secrets, timeout_s: float = 1.0, retries: int = 2
    ) -> None:
        """Prepare; nothing is sent yet.  Raises InputError for a bad address or secrets."""
        try:
            api = importlib.import_module("pysnmp.hlapi.v3arch.asyncio")
        except ImportError:
            raise InputError(
                "signs need the package pysnmp; install the extra: pip install 'queuetail[signs]'"
            ) from None
        self._api: Any = api
        self.host, self.port = split_address(address)
        self._auth = _auth(api, secrets)
        self._timeout_s, self._retries = timeout_s, retries
        self._engine: Any = None
        self._target: Any = None

    async def get(self, *oids: Oid, what: str) -> tuple[Value, ...]:
        """Return the values of objects; raises SignSilent or SnmpRefused."""
        api = self._api
        asked = [api.ObjectType(api.ObjectIdentity(oid)) for oid in oids]
        return await self._request(api.get_cmd, asked, oids, what)

    async def set(self, *pairs: tuple[Oid, Value], what: str) -> None:
        """Set objects, all or none; raises SignSilent or SnmpRefused."""
        api = self._api
        given = [
            api.ObjectType(
                api.ObjectIdentity(oid),
                api.Integer32(value) if isinstance(value, int) else api.OctetString(value),
            )
            for oid, value in pairs
        ]
        await self._request(api.set_cmd, given, [oid for oid, _ in pairs], what)

    @property
    def peer_ip(self) -> str:
        """The sign's address as a number, once it was looked up."""
        return str(self._target.transport_address[0]) if self._target is not None else self.host

    def close(self) -> None:
        """Release the socket."""
        if self._engine is not None:
            self._engine.close_dispatcher()
            self._engine = self._target = None

    async def _request(
        self, command: Any, objects: list[Any], oids: Sequence[Oid], what: str
    ) -> tuple[Value, ...]:
        await self._open()
        limit_s = self._timeout_s * (self._retries + 1) + SLACK_S
        try:
            answer = await asyncio.wait_for(
                command(
                    self._engine,
                    self._auth,
                    self._target,
                    self._api.ContextData(),
                    *objects,
                    lookupMib=False,
                ),
                limit_s,
            )
        except TimeoutError:
            self.close()
            raise SignSilent(self._silence(what)) from None
        except Exception as error:
            # pysnmp and pyasn1 raise many kinds of errors on hostile packets: none may pass.
            self.close()
            raise SignSilent(
                f"the sign at {self._place} answered with something that is not SNMP "
                f"when asked to {what} ({type(error).__name__})"
            ) from error
        failure, status, index, found = answer
        if failure:
            self.close()
            raise SignSilent(self._failure(failure, what))
        if int(status):
            raise SnmpRefused(int(status), int(index or 0), what)
        return self._checked(found, oids, what)

    async def _open(self) -> None:
        """Make the engine and look the host up, once."""
        if self._target is not None:
            return
        api = self._api
        try:
            self._target = await guarded_target(api, ":" in self.host).create(
                (self.host, self.port), timeout=self._timeout_s, retries=self._retries
            )
        except Exception:
            raise SignSilent(f"the sign's address {self.host} cannot be looked up") from None
        self._engine = api.SnmpEngine()

    def _checked(self, found: Sequence[Any], oids: Sequence[Oid], what: str) -> tuple[Value, ...]:
        """Return the values when they are those of the objects asked for."""
        strange = SignSilent(f"the sign at {self._place} answered nonsense when asked to {what}")
        if len(found) != len(oids):
            raise strange
        values: list[Value] = []
        for pair, oid in zip(found, oids, strict=True):
            name, value = pair[0], pair[1]
            if tuple(name) != oid:
                raise strange
            values.append(_plain(self._api, value, strange))
        return tuple(values)

    @property
    def _place(self) -> str:
        return f"{self.host}:{self.port}"

    def _silence(self, what: str) -> str:
        return (
            f"the sign at {self._place} does not answer, asked to {what}: check its address, its "
            "power, the link and the community or user"
        )

    def _failure(self, failure: Any, what: str) -> str:
        """Say what pysnmp's own error means; its text holds no secrets, but does not help."""
        kind = type(failure).__name__
        if kind in ("RequestTimedOut", "UnknownEngineID"):
            return self._silence(what)
        reasons = {
            "UnknownUserName": "it does not know the SNMPv3 user",
            "WrongDigest": "the SNMPv3 auth_key is wrong",
            "AuthenticationFailure": "the SNMPv3 auth_key or auth is wrong",
            "UnsupportedSecurityLevel": "its SNMPv3 user has another security level",
            "NotInTimeWindow": "its SNMPv3 clock does not agree",
            "DecryptionError": "the SNMPv3 priv_key or priv is wrong",
            "UnsupportedAuthProtocol": "the SNMPv3 auth is not supported",
            "UnsupportedPrivProtocol": "the SNMPv3 priv is not supported",
            "EncryptionError": "SNMPv3 encryption needs the package cryptography",
        }
        why = reasons.get(kind, f"SNMP failed ({kind})")
        return f"the sign at {self._place} cannot {what}: {why}"


def _plain(api: Any, value: Any, strange: SignSilent) -> Value:
    """Return an integer or octets; raises `strange` for anything else, or too much of it."""
    if isinstance(value, api.OctetString):
        octets = bytes(value)
        if len(octets) > LONGEST_OCTETS:
            raise strange
        return octets
    if isinstance(value, (api.Integer32, api.Unsigned32, api.Counter32)) or (
        type(value).__name__ == "Integer"
    ):
        return int(value)
    if type(value).__name__ in ("NoSuchObject", "NoSuchInstance", "EndOfMibView"):
        raise SnmpRefused(2, 1, "read an object")  # SNMPv3 says so in place of an error
    raise strange


def _auth(api: Any, secrets: Secrets) -> Any:
    if secrets.user is None:
        community = secrets.community.get_secret_value() if secrets.community else "public"
        return api.CommunityData(community, mpModel=0)
    return api.UsmUserData(secrets.user, **user_keys(secrets)[1])


def user_keys(secrets: Secrets) -> tuple[str, dict[str, Any]]:
    """Return the SNMPv3 security level of a user, and its keys in pysnmp's words."""
    config = importlib.import_module("pysnmp.entity.config")
    auth = {
        "md5": config.USM_AUTH_HMAC96_MD5,
        "sha": config.USM_AUTH_HMAC96_SHA,
        "sha224": config.USM_AUTH_HMAC128_SHA224,
        "sha256": config.USM_AUTH_HMAC192_SHA256,
        "sha384": config.USM_AUTH_HMAC256_SHA384,
        "sha512": config.USM_AUTH_HMAC384_SHA512,
    }
    priv = {
        "des": config.USM_PRIV_CBC56_DES,
        "3des": config.USM_PRIV_CBC168_3DES,
        "aes128": config.USM_PRIV_CFB128_AES,
        "aes192": config.USM_PRIV_CFB192_AES,
        "aes256": config.USM_PRIV_CFB256_AES,
    }
    if secrets.auth_key is None:
        return "noAuthNoPriv", {}
    keys = {"authKey": secrets.auth_key.get_secret_value(), "authProtocol": auth[secrets.auth]}
    if secrets.priv_key is None:
        return "authNoPriv", keys
    if importlib.util.find_spec("cryptography") is None:
        raise InputError(
            "priv_key asks for encrypted SNMPv3, which needs the package cryptography: "
            "pip install cryptography"
        )
    keys |= {"privKey": secrets.priv_key.get_secret_value(), "privProtocol": priv[secrets.priv]}
    return "authPriv", keys
