"""Feeds and messages: the answers of a live run, in the formats that others read."""
