"""The commands for hands-on work, against a simulated sign; and the simulated sign as a command."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from queuetail.cli import main
from queuetail.signs import arming
from queuetail.signs.agent import SignAgent
from queuetail.signs.arming import Arming

TWO = (("STOPPED", "TRAFFIC", "1/2 MILE"), ("PREPARE", "TO STOP"))


@pytest.fixture(scope="module")
def agent() -> Iterator[SignAgent]:
    with SignAgent() as running:
        yield running


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("COMMUNITY", "USER", "AUTH_KEY", "PRIV_KEY"):
        monkeypatch.delenv(f"QUEUETAIL_SIGN_{name}", raising=False)


def site_file(folder: Path, address: str) -> Path:
    path = folder / "site.toml"
    path.write_text(
        f'[[sign]]\nname = "PCMS 1"\nstation_m = 0\naddress = "{address}"\n'
        'default = [["ROAD", "WORK"]]\n[[sign]]\nname = "PCMS 2"\nstation_m = 0\n'
    )
    return path


def test_show_status_blank(agent: SignAgent, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["STOPPED / TRAFFIC / 1/2 MILE", "PREPARE / TO STOP"]
    assert main(["sign", "show", *words, "--to", agent.address, "--minutes", "2"]) == 0
    assert agent.phases() == TWO
    shown = capsys.readouterr().out
    assert "STOPPED / TRAFFIC / 1/2 MILE | PREPARE / TO STOP" in shown
    assert "put there by central control (such as queuetail), for 2 more minutes" in shown
    assert main(["sign", "status", "--to", agent.address]) == 0
    assert capsys.readouterr().out == shown
    assert main(["sign", "blank", "--to", agent.address]) == 0
    assert "shows    (blank)" in capsys.readouterr().out
    assert agent.phases() == ()


def test_a_sign_of_a_site_file_keeps_its_default(agent: SignAgent, tmp_path: Path) -> None:
    site = ["--site", str(site_file(tmp_path, agent.address)), "--sign", "PCMS 1"]
    assert main(["sign", "show", "STOP", *site, "--priority", "255"]) == 0
    agent.sign.lose_power()
    assert agent.phases() == (("ROAD", "WORK"),)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["show", "--to", "SIGN"], "say what to show"),
        (["show", "CAFÉ", "--to", "SIGN"], "plain ASCII"),
        (["show", "[nl]A", "--to", "SIGN"], "has a tag"),
        (["show", "{distance}", "--to", "SIGN"], "write the distance itself"),
        (["show", "A", "B", "C", "--to", "SIGN"], "two phases at most"),
        (["show", "MUCH TOO WIDE", "--to", "SIGN"], "larger than its face"),
        (["show", "MUCH TOO WIDE", "--site", "SITE", "--sign", "PCMS 1"], "does not fit"),
        (["show", "A", "--to", "SIGN", "--minutes", "0"], "--minutes is 1"),
        (["status"], "say which sign"),
        (["status", "A", "--to", "SIGN"], "takes no text"),
        (["status", "--site", "SITE"], "choose one with --sign (PCMS 1, PCMS 2)"),
        (["status", "--site", "SITE", "--sign", "X"], "has no sign 'X'"),
        (["status", "--site", "SITE", "--sign", "PCMS 2"], "has no address"),
        (["status", "--to", "sign:x"], "no address of a sign"),
        (["status", "--to", "http://sign"], "no address of a sign"),
        (["show", "", "--to", "SIGN"], "say what to show"),
        (["status", "--to", "127.0.0.1:1"], "does not answer"),
        (["status", "--to", "no-such-sign.invalid"], "cannot be looked up"),
        (["arm"], "--run RUN_DIR"),
        (["arm", "--run", "SITE"], "not the folder of a live run"),
    ],
)
def test_what_is_wrong_is_one_sentence(
    words: list[str],
    sentence: str,
    agent: SignAgent,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    real = {"SIGN": agent.address, "SITE": str(site_file(tmp_path, agent.address))}
    assert main(["sign", *(real.get(word, word) for word in words)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert "Traceback" not in error


@pytest.mark.parametrize("words", [["--port", "70000"], ["--port", "-5"], ["--duration", "-3"]])
def test_a_simulated_sign_refuses_impossible_numbers(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["sign", "simulate", *words])
    assert refused.value.code == 2
    assert "is no " in capsys.readouterr().err


def test_arm_and_disarm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    switch = Arming(tmp_path, lambda event, record: None)
    monkeypatch.setattr(arming, "sleep", lambda seconds: switch.poll())
    assert main(["sign", "arm", "--run", str(tmp_path), "--who", "R. Roe"]) == 0
    assert re.match(r"armed by R\. Roe at 20\d\d-", capsys.readouterr().out)
    assert switch.armed
    assert main(["sign", "disarm", "--run", str(tmp_path)]) == 0
    assert not switch.armed
    assert switch.state.who == arming.operator()


def test_a_simulated_sign_as_a_command(tmp_path: Path) -> None:
    """It answers with the community of a private file, draws its face, and ends on SIGTERM."""
    secrets, face = tmp_path / "sign.toml", tmp_path / "face.png"
    secrets.write_text('community = "training"')
    secrets.chmod(0o600)
    command = [sys.executable, "-m", "queuetail.cli", "sign", "simulate", "--port", "0"]
    command += ["--face", str(face), "--secrets", str(secrets), "--duration", "60"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        try:
            found = re.search(r"answers at (\S+);", running.stdout.readline())
            assert found is not None
            blank = [running.stdout.readline() for _ in range(5)]
            assert blank[1] == "|          |\n"
            before = face.read_bytes()
            to = ["--to", found[1], "--secrets", str(secrets)]
            assert main(["sign", "show", "HELLO", *to]) == 0
            shown = [running.stdout.readline() for _ in range(5)]
            assert shown[2] == "|  HELLO   |\n"
            running.send_signal(signal.SIGTERM)
            assert running.wait(20) == 0
            assert face.read_bytes() != before
        finally:
            running.kill()
