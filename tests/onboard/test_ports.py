"""What cannot be a serial line is said before anything starts; what is only unplugged is not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from queuetail.cli import main
from queuetail.errors import InputError
from queuetail.onboard.ports import SerialPort, serial_line, split_device


@pytest.mark.parametrize("device", ["", "rubbish", "/dev/null", "/tmp", __file__])
def test_what_is_no_serial_line(device: str) -> None:
    with pytest.raises(InputError, match="is no serial line; write a device such as /dev/ttyUSB0"):
        split_device(device, 9600)


def test_a_line_that_is_there_and_one_that_may_come(tmp_path: Path) -> None:
    master, slave = os.openpty()
    name = os.ttyname(slave)
    assert serial_line(name) == name
    assert serial_line(str(tmp_path / "ttyUSB0")) == str(tmp_path / "ttyUSB0")
    assert serial_line("COM3") == "COM3"
    for end in (master, slave):
        os.close(end)


def test_why_a_line_cannot_be_opened_is_said_once(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"ttyUSB0: No such file or directory$"):
        SerialPort(str(tmp_path / "ttyUSB0"), 9600)
    master, slave = os.openpty()
    first = SerialPort(os.ttyname(slave), 9600)
    with pytest.raises(OSError, match="another program has it open"):
        SerialPort(os.ttyname(slave), 9600)
    first.close()
    for end in (master, slave):
        os.close(end)


def test_a_source_that_is_not_there_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Sources are looked at once a second: the first look may be before this one was tried.
    words = ["onboard", "--radio", str(tmp_path / "ttyUSB0"), "--duration", "1.5"]
    assert main([*words, "--lidar", str(tmp_path / "ttyUSB1")]) == 0
    said = capsys.readouterr().err
    assert "ttyUSB1: not heard (" in said
    assert said.count("ttyUSB1: No such file or directory") == 1


@pytest.mark.parametrize("duration", ["-3", "nan", "soon"])
def test_impossible_durations(duration: str) -> None:
    with pytest.raises(SystemExit):
        main(["onboard", "--radio", "/dev/ttyUSB0", "--duration", duration])
