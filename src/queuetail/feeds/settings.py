"""`[feeds]` of a site file: who is told where the queue ends, in which format, and how."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator

from queuetail.settings import Settings

Port = Annotated[int, Field(ge=1, le=65_535)]
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$")]
Validity = Annotated[float, Field(ge=2, le=600)]
Direction = Literal[  # WZDx 4.2: Direction
    "northbound",
    "eastbound",
    "southbound",
    "westbound",
    "inner-loop",
    "outer-loop",
    "undefined",
    "unknown",
]


def _web_address(text: str) -> str:
    """Check that a text is an address that a feed may post to; raises ValueError."""
    parts = urlsplit(text)
    if parts.scheme not in ("https", "http") or not parts.hostname:
        raise ValueError("an address to post to begins with https:// and names a host")
    if parts.username is not None or parts.password is not None:
        raise ValueError("an address must not hold a user or a password")
    if any(c <= " " or c == "\x7f" for c in text):
        raise ValueError("an address has no spaces")
    try:
        _ = parts.port
    except ValueError:
        raise ValueError("the port of the address is none") from None
    return text


WebAddress = Annotated[str, AfterValidator(_web_address)]


class Posted(Settings):
    """What every feed that posts to a web address can be told."""

    allow_private: bool = False  # addresses of this machine and of private networks, and http://
    ca_file: Path | None = None
    timeout_s: Annotated[float, Field(ge=0.5, le=60)] = 5.0

    def check_address(self, url: str) -> None:
        """Refuse plain HTTP to the outside; raises ValueError."""
        if urlsplit(url).scheme == "http" and not self.allow_private:
            raise ValueError("http:// is for your own network only: set allow_private = true")


class WzdxFeed(Settings):
    """`[feeds.wzdx]`: a WZDx 4.2 device feed at /feeds/wzdx.geojson."""

    data_source_id: Name = "queuetail"
    update_s: Annotated[int, Field(ge=1, le=3600)] = 5
    contact_name: Name | None = None
    contact_email: Annotated[str, Field(pattern=r"^[^@\s]+@[^@\s]+$")] | None = None
    cc0: bool = False  # WZDx knows one licence; it is named only where you grant it
    file: Path | None = None


class CifsFeed(Settings):
    """`[feeds.cifs]`: a Waze partner feed at /feeds/cifs.json."""

    street: Name | None = None
    kind: Literal["jam", "hazard"] = "jam"
    valid_s: Validity = 120.0
    file: Path | None = None


class CapFeed(Posted):
    """`[feeds.cap]`: CAP 1.2 alerts at /feeds/cap.xml, and posted where a url is given."""

    sender: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\s,<&]+$")]
    status: Literal["Actual", "Exercise", "System", "Test", "Draft"] = "Test"
    scope: Literal["Public", "Restricted", "Private"] = "Private"
    restriction: Name | None = None
    addresses: Name | None = None
    valid_s: Validity = 120.0
    url: WebAddress | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> CapFeed:
        if self.scope == "Restricted" and self.restriction is None:
            raise ValueError("a Restricted alert needs its restriction (CAP 1.2 section 3.2.1)")
        if self.scope == "Private" and self.addresses is None:
            raise ValueError("a Private alert needs addresses (CAP 1.2 section 3.2.1)")
        if self.url is not None:
            self.check_address(self.url)
        return self


class MqttFeed(Settings):
    """`[feeds.mqtt]`: the state, retained, and every change, on an MQTT broker."""

    host: Name
    port: Port | None = None
    topic: Annotated[str, Field(max_length=200, pattern=r"^[^+#\x00/$][^+#\x00]*$")] = "queuetail"
    tls: bool = False
    ca_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None
    username: Name | None = None
    password_file: Path | None = None
    protocol: Literal["5", "3.1.1"] = "5"
    every_s: Annotated[float, Field(ge=0.2, le=60)] = 1.0
    valid_s: Validity = 10.0

    @model_validator(mode="after")
    def _is_whole(self) -> MqttFeed:
        certificates = (self.ca_file, self.cert_file, self.key_file)
        if not self.tls and any(certificates):
            raise ValueError("certificates need tls = true")
        if (self.cert_file is None) != (self.key_file is None):
            raise ValueError("cert_file and key_file go together")
        if self.password_file is not None and self.username is None:
            raise ValueError("a password needs its username")
        if self.every_s * 2 > self.valid_s:
            raise ValueError("valid_s has to be twice every_s or more")
        return self


class WebhookFeed(Posted):
    """`[[feeds.webhook]]`: every change, signed and posted to an address of yours."""

    url: WebAddress
    name: Name = "webhook"
    secret_file: Path | None = None
    refresh_s: Annotated[float, Field(ge=1, le=300)] = 15.0
    valid_s: Validity = 60.0

    @model_validator(mode="after")
    def _is_safe(self) -> WebhookFeed:
        self.check_address(self.url)
        if self.refresh_s * 2 > self.valid_s:
            raise ValueError("valid_s has to be twice refresh_s or more")
        return self


class CotFeed(Settings):
    """`[feeds.cot]`: Cursor on Target events for TAK, by UDP, TCP or TLS."""

    url: str = "udp://239.2.3.1:6969"  # TAK's situational awareness multicast
    type: Annotated[str, Field(pattern=r"^[a-zA-Z0-9]+(-[a-zA-Z0-9]+)+$")] = "b-m-p-s-m"
    callsign: Name = "END OF QUEUE"
    ttl: Annotated[int, Field(ge=0, le=255)] = 1
    ca_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None
    server_name: Name | None = None
    refresh_s: Annotated[float, Field(ge=1, le=300)] = 5.0
    valid_s: Validity = 30.0

    @model_validator(mode="after")
    def _is_whole(self) -> CotFeed:
        _check_socket(self.url, ("udp", "tcp", "tls"))
        if (self.cert_file is None) != (self.key_file is None):
            raise ValueError("cert_file and key_file go together")
        tls_only = (self.ca_file, self.cert_file, self.server_name)
        if any(tls_only) and not self.url.startswith("tls://"):
            raise ValueError("ca_file, cert_file, key_file and server_name need a tls:// url")
        if self.refresh_s * 2 > self.valid_s:
            raise ValueError("valid_s has to be twice refresh_s or more")
        return self


class TimFeed(Posted):
    """`[feeds.tim]`: Traveler Information Messages, as the USDOT's ODE takes them."""

    url: WebAddress
    request_file: Path | None = None  # RSUs, SNMP, SDW: with passwords, so mode 0600
    items: Annotated[tuple[Name, ...], Field(min_length=1, max_length=100)] = (
        *("1025", "7186", "7443"),  # road construction, prepare to stop, reduce your speed
    )
    warn_m: Annotated[float, Field(ge=50, le=5000)] = 1500.0
    refresh_s: Annotated[float, Field(ge=5, le=300)] = 20.0

    @model_validator(mode="after")
    def _is_safe(self) -> TimFeed:
        self.check_address(self.url)
        return self


class DenmFeed(Settings):
    """`[feeds.denm]`: ETSI DENMs (dangerous end of queue) as UPER, by UDP."""

    url: str
    station_id: Annotated[int, Field(ge=0, le=4_294_967_295)]
    sub_cause: Annotated[int, Field(ge=0, le=4)] = 1  # suddenEndOfQueue
    trace_m: Annotated[float, Field(ge=50, le=2000)] = 1000.0
    refresh_s: Annotated[float, Field(ge=0.5, le=60)] = 1.0
    valid_s: Validity = 10.0

    @model_validator(mode="after")
    def _is_whole(self) -> DenmFeed:
        _check_socket(self.url, ("udp",))
        if self.refresh_s * 2 > self.valid_s:
            raise ValueError("valid_s has to be twice refresh_s or more")
        return self


class FeedsSettings(Settings):
    """`[feeds]`: what all feeds have in common, and a table for each that is switched on."""

    organization: Name = "queuetail"
    road: Name | None = None
    direction: Direction = "unknown"
    sigma_factor: Annotated[float, Field(ge=0, le=5)] = 2.0
    max_age_s: Annotated[float, Field(ge=1, le=60)] = 3.0
    settle_s: Annotated[float, Field(ge=0, le=30)] = 2.0
    moved_m: Annotated[float, Field(ge=1, le=500)] = 25.0
    wzdx: WzdxFeed | None = None
    cifs: CifsFeed | None = None
    cap: CapFeed | None = None
    mqtt: MqttFeed | None = None
    webhook: tuple[WebhookFeed, ...] = ()
    cot: CotFeed | None = None
    tim: TimFeed | None = None
    denm: DenmFeed | None = None

    @model_validator(mode="after")
    def _has_different_webhooks(self) -> FeedsSettings:
        names = [hook.name for hook in self.webhook]
        if len(set(names)) != len(names):
            raise ValueError("two webhooks have the same name")
        return self


def _check_socket(url: str, schemes: tuple[str, ...]) -> None:
    """Check an address of the form scheme://host:port; raises ValueError."""
    parts = urlsplit(url)
    try:
        whole = parts.scheme in schemes and bool(parts.hostname) and bool(parts.port)
    except ValueError:
        whole = False
    if not whole or parts.path or parts.query or parts.fragment or "@" in url:
        forms = " or ".join(f"{scheme}://host:port" for scheme in schemes)
        raise ValueError(f"the url has to be {forms}")
