"""Compiled programs kept between processes, so that the same learner starts at once the second time."""

import importlib.util
import os
import sys
from pathlib import Path

VARIABLE = "ODAF_CACHE_DIR"
# Small programs too: a training compiles fifty of them, which takes a second together.
_SHORTEST_SECONDS = 0.0
_LARGEST_BYTES = 2**30


def use_compilation_cache(wanted: bool = True) -> None:
    """Lets JAX keep compiled programs in the user's cache folder; called by commands that train, before they compile.

    A folder that is set already, as by `JAX_COMPILATION_CACHE_DIR`, stays. A folder that cannot be written to costs a
    message and nothing else. The oldest programs make room beyond 1 GiB where `filelock` is installed.

    Args:
        wanted: False keeps no programs and uses none, whatever is set.
    """
    import jax

    if not wanted:
        jax.config.update("jax_enable_compilation_cache", False)
        return
    if jax.config.values["jax_compilation_cache_dir"] is not None:
        return
    folder = cache_directory() / "compiled"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
        cause = "it cannot be written to"
    except OSError as error:
        writable, cause = False, (error.strerror or str(error)).lower()
    if not writable:
        print(
            f"{folder}: {cause}, so compiled programs are not kept; name another folder in {VARIABLE}", file=sys.stderr
        )
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", _SHORTEST_SECONDS)
    if importlib.util.find_spec("filelock") is not None:  # JAX needs it to remove programs while others read
        jax.config.update("jax_compilation_cache_max_size", _LARGEST_BYTES)


def cache_directory() -> Path:
    """`ODAF_CACHE_DIR`, or odaf's folder where this system keeps a user's caches."""
    given = os.environ.get(VARIABLE)
    if given:
        return Path(given).expanduser()
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "odaf"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "odaf"
    # The rules of XDG: a path that is not absolute counts as not given.
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "odaf"
