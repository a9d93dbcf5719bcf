"""Memory that the compiler has freed goes back to the system, where the C library can be asked to."""

import ctypes
import sys


def give_back_freed_memory() -> None:
    """Returns freed memory to the system; does nothing where the C library is not glibc.

    glibc keeps what was freed in many small pieces: after a large program was compiled, much of the process. What is
    allocated next would make it grow further. `benchmarks/first_update.py` measures the peak.
    """
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
