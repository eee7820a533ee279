"""The drone's end of the telemetry link: sensors in, frames out, on a small companion computer.

Nothing here may load numpy or OpenCV; the sources also serve the ground, which hears some directly.
"""
