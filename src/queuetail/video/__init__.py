"""Video: PyAV capture with true timestamps."""

from queuetail.video.capture import VideoFile, VideoInfo

__all__ = ["VideoFile", "VideoInfo"]
