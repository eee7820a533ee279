"""From the end of the queue to what a warning sign shows, and to the sign itself."""
