"""What a drone says piece by piece, as partial samples of the camera's place and view."""

from __future__ import annotations

from queuetail.link.height import HeightFinder
from queuetail.link.messages import Gimbal, Heading, Lens, Position, Quantity
from queuetail.telemetry.klv import Losses, decode, sample_of
from queuetail.types import TelemetrySample

LEND_AFTER_S = 5.0  # a gimbal that tells its yaw has done so by then


class SampleBuilder:
    """Turns quantities into samples with the fields that they tell.

    The camera's heading is the gimbal's; only a drone that never tells a gimbal yaw lends its own.
    """

    def __init__(self) -> None:
        self._has_gimbal_yaw = False
        self._heights = HeightFinder()
        self._first_s: float | None = None

    def sample(self, quantity: Quantity, t_s: float) -> TelemetrySample | None:
        """Return what the quantity says of the camera at `t_s`; None where it says nothing."""
        if self._first_s is None:
            self._first_s = t_s
        match quantity:
            case Position(lat_deg, lon_deg):
                return TelemetrySample(t_s, lat_deg, lon_deg)
            case Gimbal(yaw_deg, pitch_deg, roll_deg):
                self._has_gimbal_yaw = self._has_gimbal_yaw or yaw_deg is not None
                return TelemetrySample(
                    t_s,
                    heading_deg=yaw_deg,
                    gimbal_pitch_deg=pitch_deg,
                    gimbal_roll_deg=roll_deg,
                )
            case Heading(deg):
                is_lent = not self._has_gimbal_yaw and t_s - self._first_s > LEND_AFTER_S
                return TelemetrySample(t_s, heading_deg=deg) if is_lent else None
            case Lens(hfov_deg):
                return TelemetrySample(t_s, hfov_deg=hfov_deg)
        height = self._heights.add(quantity, t_s)
        return None if height is None else TelemetrySample(t_s, height_agl_m=height.agl_m)


def klv_reading(packet: bytes, t_s: float = 0.0) -> tuple[TelemetrySample, float | None] | None:
    """Return what a KLV packet of the video stream says, and its UTC in seconds since 1970.

    None where it holds no MISB ST 0601 set with a right checksum.
    """
    packets = decode(packet, Losses())
    if not packets:
        return None
    sample, _ = sample_of(packets[-1], t_s)
    return sample, packets[-1].stamp_s
