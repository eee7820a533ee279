"""The commands, one module per group; each adds its parsers and calls what does the work."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]
else:
    Commands = object

INTERRUPTED = 130  # what a shell expects after Ctrl-C
