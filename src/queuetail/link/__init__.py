"""The telemetry link's wire protocol, shared by both ends: no files, threads, clocks.

Nothing here may load numpy or OpenCV: it runs on the drone's companion computer.
"""
