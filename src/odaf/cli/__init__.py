"""The `odaf` command: one module per command, each of which reads its options and calls the library."""

from odaf.cli.dispatch import main

__all__ = ["main"]
