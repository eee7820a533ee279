"""Pure tracking: objects followed from frame to frame."""
