"""Live work: capture, telemetry, processing and outlets, apart and joined by small mailboxes."""
