"""The one error that a user sees: a sentence with what is wrong, where, and the mend."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used; its text is one clear sentence for the user (exit code 2)."""
