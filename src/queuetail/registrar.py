"""Which image motion a preset measures: none, or that of the ground."""

from __future__ import annotations

import numpy as np

from queuetail.mapping import TelemetryMapper
from queuetail.types import Floats, Frame, GroundMapping, Registration, TelemetrySample, Unknown
from queuetail.vision.register import GroundRegistration

STILL = Registration(np.eye(3), 1.0)


class NoRegistration:
    """The paper's: telemetry alone says how the camera moves."""

    def register(self, frame: Frame, telemetry: TelemetrySample) -> Registration:
        """Return the identity."""
        return STILL


class FrameRegistrar:
    """Registers every frame, with the motion that telemetry reports as the prior."""

    def __init__(self, width_px: int, height_px: int, telemetry: TelemetryMapper | None) -> None:
        self._registration = GroundRegistration(width_px, height_px)
        self._telemetry = telemetry
        self._epoch = -1
        self._reference: GroundMapping | None = None

    def register(self, frame: Frame, telemetry: TelemetrySample) -> Registration:
        """Return the motion since the reference picture; `reason` says why it is lost."""
        result = self._registration.register(
            frame.luma, frame.t_s, None, lambda: self._predicted(telemetry)
        )
        if result.epoch != self._epoch and not result.reason:
            self._epoch, self._reference = result.epoch, self._told(telemetry)
        return result

    def _predicted(self, telemetry: TelemetrySample) -> Floats | None:
        """Return the motion since the reference picture that telemetry reports, H_ref_frame."""
        told = self._told(telemetry)
        if told is None or self._reference is None:
            return None
        H = self._reference.H_px_enu @ told.H_enu_px
        return np.asarray(H / H[2, 2])

    def _told(self, telemetry: TelemetrySample) -> GroundMapping | None:
        if self._telemetry is None:
            return None
        mapping = self._telemetry.mapping(telemetry, STILL)
        return None if isinstance(mapping, Unknown) else mapping
