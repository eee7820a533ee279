"""queuetail: where is the end of the traffic queue?"""

__version__ = "0.1.0"
