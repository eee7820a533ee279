"""Telemetry: one adapter per format, all giving the same samples."""

from queuetail.telemetry.flightlog import FlightLog
from queuetail.telemetry.read import read_telemetry

__all__ = ["FlightLog", "read_telemetry"]
