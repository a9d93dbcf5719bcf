"""Runs `odaf` and writes down how many programs came from the folder of compiled ones, and how many from the compiler.

    python benchmarks/counted.py COUNTS.json train odaf --data log.hdf5 --out runs/odaf

What stands after the file's name is a command of odaf.
"""

import json
import sys
from collections import Counter
from pathlib import Path

import jax

_EVENTS = {
    "/jax/compilation_cache/cache_hits": "loaded",
    "/jax/compilation_cache/cache_misses": "compiled",
}


def main(arguments: list[str]) -> None:
    """Runs the command line and leaves {"loaded": programs, "compiled": programs} in the first argument's file."""
    counts = Counter(dict.fromkeys(_EVENTS.values(), 0))

    def listener(event: str, **about: str | int) -> None:
        del about
        if event in _EVENTS:
            counts[_EVENTS[event]] += 1

    jax.monitoring.register_event_listener(listener)
    from odaf.cli import main as odaf

    sys.argv = ["odaf", *arguments[1:]]
    try:
        sys.exit(odaf())
    finally:
        Path(arguments[0]).write_text(json.dumps(counts))


if __name__ == "__main__":
    main(sys.argv[1:])
