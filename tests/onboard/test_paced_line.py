"""A short version of benchmarks/link.py: the whole link over 9600 baud with bit errors."""

from __future__ import annotations

import pytest

from link import line_run, noise_run


@pytest.mark.parametrize("bit_error_rate", [0.0, 1e-3])
def test_a_simulated_flight_over_a_noisy_line(bit_error_rate: float) -> None:
    result = line_run(2.0, bit_error_rate)
    assert result.wrong == 0
    assert result.received > 0.5 * result.sent
    assert result.lost <= result.sent - result.received
    if not bit_error_rate:
        assert result.received == result.sent
    assert result.sent_bytes / result.seconds < 1_000
    assert result.peak_mb < 60


def test_random_messages_through_noise() -> None:
    result = noise_run(5_000, 1e-3)
    assert result.wrong == 0
    assert result.accepted > 4_000
    assert result.bad_frames > 0
