"""Synthetic flights with exact ground truth: SUMO moves vehicles, a pinhole camera draws."""
