"""Secrets come from a private file or from the environment, and go nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest

from queuetail.errors import InputError
from queuetail.signs.secrets import Secrets, read_secrets


def secret_file(folder: Path, text: str, mode: int = 0o600) -> Path:
    path = folder / "sign.toml"
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return path


def community(secrets: Secrets) -> str | None:
    return secrets.community and secrets.community.get_secret_value()


def test_the_community_of_a_private_file(tmp_path: Path) -> None:
    found = read_secrets(secret_file(tmp_path, 'community = "hush"'))
    assert community(found) == "hush"
    assert "hush" not in repr(found)
    assert "hush" not in found.model_dump_json()


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o620, 0o666])
def test_a_file_that_others_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    with pytest.raises(InputError, match="chmod 600"):
        read_secrets(secret_file(tmp_path, 'community = "hush"', mode))


def test_the_environment_comes_next_and_public_last() -> None:
    assert community(read_secrets(None, {})) == "public"
    assert community(read_secrets(None, {"QUEUETAIL_SIGN_COMMUNITY": "hush"})) == "hush"
    found = read_secrets(None, {"QUEUETAIL_SIGN_USER": "q", "QUEUETAIL_SIGN_AUTH_KEY": "12345678"})
    assert found.user == "q"
    assert found.auth == "sha256"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('community = "a"\nuser = "b"', "not both"),
        ('auth_key = "12345678"', "needs its user"),
        ('user = "q"\npriv_key = "12345678"', "priv_key needs auth_key"),
        ('user = "q"\nauth_key = "hush"', "auth_key"),
        ("community = 7", "text in quotes"),
        ('comunity = "a"', "did you mean 'community'"),
        ("community", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_told_without_the_secret(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(InputError) as refused:
        read_secrets(secret_file(tmp_path, text))
    assert sentence in str(refused.value)
    assert "hush" not in str(refused.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_secrets(tmp_path / "none.toml")
