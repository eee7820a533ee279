"""Signed webhooks: every change of every approach, in order, to an address of the user's.

The signature is HMAC-SHA256 over the time of sending, a dot and the body, so that nobody can repeat
an old message as new; docs/feeds.md has the receiver's side.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import time
from collections.abc import Callable, Mapping

from queuetail.errors import InputError
from queuetail.feeds.episodes import Report
from queuetail.feeds.posting import Poster
from queuetail.feeds.secrets import read_secret
from queuetail.feeds.settings import WebhookFeed
from queuetail.feeds.state_json import FORMAT, state_record

VARIABLE = "QUEUETAIL_WEBHOOK_SECRET"
SHORTEST_SECRET = 16
TIMESTAMP, SIGNATURE = "X-Queuetail-Timestamp", "X-Queuetail-Signature"
DELIVERY = "X-Queuetail-Delivery"


class Webhook:
    """Posts reports to one address; for one thread."""

    def __init__(
        self,
        site: str,
        run: str,
        feed: WebhookFeed,
        environment: Mapping[str, str] | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """Read the secret; `run` is this run's name.  Raises InputError without a good secret."""
        secret = read_secret(feed.secret_file, VARIABLE, "the webhook's secret", environment)
        if secret is None:
            raise InputError(
                f"webhook {feed.name!r} has no secret to sign with: give secret_file in the site "
                f"file, or {VARIABLE} in the environment"
            )
        if len(secret) < SHORTEST_SECRET:
            raise InputError(
                f"the secret of webhook {feed.name!r} is shorter than {SHORTEST_SECRET} characters"
            )
        self._key = secret.encode()
        self._site, self._run, self._feed, self._clock = site, run, feed, clock
        self._poster = Poster(feed.url, feed)

    def deliver(self, report: Report) -> None:
        """Post one report; signed anew at each try."""
        body = self.body(report)
        timestamp = str(int(self._clock()))
        headers = {
            "Content-Type": "application/json",
            DELIVERY: f"{self._run}-{report.sequence}",
            TIMESTAMP: timestamp,
            SIGNATURE: f"sha256={signature(self._key, timestamp, body)}",
        }
        self._poster.send(body, headers)

    def body(self, report: Report) -> bytes:
        """Return what is posted."""
        record = {
            "format": FORMAT,
            "site": self._site,
            "run": self._run,
            "sequence": report.sequence,
            "change": report.change.value,
            **state_record(report.answer, self._feed.valid_s),
        }
        return json.dumps(record, ensure_ascii=False, allow_nan=False).encode()


def signature(key: bytes, timestamp: str, body: bytes) -> str:
    """Return the signature of a body that is sent at `timestamp` (seconds since 1970), as hex."""
    return hmac.new(key, timestamp.encode() + b"." + body, hashlib.sha256).hexdigest()
