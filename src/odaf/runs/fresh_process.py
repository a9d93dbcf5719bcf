"""What a fresh process has to be told of the one that began it."""

from dataclasses import dataclass
from typing import Any

import jax

from odaf.algorithms.base import Algorithm
from odaf.algorithms.registry import register, register_parts

# Settings of JAX that change results or where compiled programs are kept; a fresh process would not know them.
_JAX_SETTINGS = (
    "jax_platforms", "jax_enable_x64", "jax_default_matmul_precision", "jax_default_prng_impl",
    "jax_threefry_partitionable", "jax_enable_compilation_cache",
    "jax_compilation_cache_dir", "jax_compilation_cache_max_size", "jax_persistent_cache_min_compile_time_secs",
)  # fmt: skip


@dataclass(frozen=True)
class Surroundings:
    """Picklable.

    Attributes:
        registered: the parts of a learner that are not ours.
        jax_settings: by name.
    """

    registered: tuple[type, ...]
    jax_settings: dict[str, Any]

    @classmethod
    def of(cls, algorithm: Algorithm) -> "Surroundings":
        """Those of this process, for work with a learner."""
        return cls(register_parts(algorithm), {name: jax.config.values[name] for name in _JAX_SETTINGS})

    def settle(self) -> None:
        """Makes them those of this process."""
        for entry in self.registered:
            register(entry)
        for name, value in self.jax_settings.items():
            jax.config.update(name, value)
