"""Memory that the compiler has freed goes back to the system, and programs are forgotten before they fill a process."""

import ctypes
import gc
import sys
from pathlib import Path

import jax

_MAPS, _MOST_MAPS = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")


def forget_programs_in_time() -> None:
    """Forgets all compiled programs once they hold half of the memory maps that Linux allows this process.

    JAX keeps what it has compiled, and each program for a processor takes several maps, of which 65,530 are allowed by
    default: trainings of one structure share them, those of another add hundreds. A process that has none left dies
    inside the compiler. What is needed again is compiled again. Elsewhere than on Linux nothing is done.
    """
    try:
        held, most = _MAPS.read_bytes().count(b"\n"), int(_MOST_MAPS.read_text())
    except OSError:
        return
    if held > most // 2:
        jax.clear_caches()
        gc.collect()


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
