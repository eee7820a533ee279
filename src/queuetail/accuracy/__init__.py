"""How well pixels are placed: errors at known points, offsets of the pose, measured speeds."""
