"""TLS for every feed that can use it: verified, with certificates from files."""

from __future__ import annotations

import ssl
from pathlib import Path

from queuetail.errors import InputError


def tls_context(
    ca_file: Path | None = None, cert_file: Path | None = None, key_file: Path | None = None
) -> ssl.SSLContext:
    """Return a context that trusts `ca_file`, else what the system trusts; raises InputError."""
    for file in (ca_file, cert_file, key_file):
        if file is not None and not file.is_file():
            raise InputError(f"{file}: there is no such certificate or key")
    try:
        context = ssl.create_default_context(cafile=str(ca_file) if ca_file else None)
    except (ssl.SSLError, OSError):
        raise InputError(f"{ca_file} holds no certificate that can be read") from None
    if cert_file is not None:
        try:
            context.load_cert_chain(cert_file, key_file, password=_no_password)
        except (ssl.SSLError, OSError, ValueError):
            raise InputError(
                f"{cert_file} and {key_file} are no certificate and its key without a password"
            ) from None
    return context


def _no_password() -> str:
    """Keep OpenSSL from asking on the terminal."""
    raise ValueError("the key has a password")
