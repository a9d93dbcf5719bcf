"""What the bits of a run depend on beside its settings: versions, device, processor, cores; kept and compared."""

import contextlib
import datetime
import functools
import importlib.metadata
import os
import platform
import sys
from pathlib import Path
from typing import Any

import jax

from odaf import __version__
from odaf.training.settings import named_precision

_PACKAGES = (
    "jax", "jaxlib", "equinox", "optax", "numpy", "scipy", "h5py", "gymnasium", "gymnasium-robotics", "mujoco"
)  # fmt: skip
_DETERMINISTIC = ("--xla_gpu_deterministic_ops=true", "--xla_gpu_exclude_nondeterministic_ops=true")


def process_record(cores: int, precision: str) -> dict[str, Any]:
    """What this process is: versions, device, platform, command, and when it began.

    Args:
        cores: cores that a training process takes.
        precision: format of the factors of matrix products.
    """
    device = jax.devices()[0]
    return {
        "python": platform.python_version(),
        "versions": _versions(),
        "device": f"{device.platform}: {device.device_kind} x {jax.device_count()}",
        "processor": _processor(),
        "platform": platform.platform(),
        "cores": cores,
        "precision": precision,
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "command": list(sys.argv),
        "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def why_bits_differ(before: dict[str, Any], now: dict[str, Any]) -> str:
    """In words, what keeps a process from giving the bits of the one before; empty if nothing is known to.

    A GPU that may add in any order gives other bits at every start, unless XLA was told otherwise.
    """
    names = ("python", "device", "processor", "cores", "precision", "xla_flags")
    if "precision" in before:
        before = {**before, "precision": named_precision(before["precision"], before.get("device", "").split(":")[0])}
    old = {**{name: before.get(name) for name in names if name in before}, **before.get("versions", {})}
    new = {**{name: now[name] for name in names if name in before}, **now["versions"]}
    different = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    reasons = [f"{name} was {old.get(name)}, is {new.get(name)}" for name in different]
    if unrepeatable := why_bits_do_not_repeat(now):
        reasons.append(unrepeatable)
    return ", ".join(reasons)


def why_bits_do_not_repeat(process: dict[str, Any]) -> str:
    """In words, what keeps a process from giving its own bits again; empty where nothing is known to."""
    flags = process["xla_flags"]
    if process["device"].startswith("gpu") and not any(flag in flags for flag in _DETERMINISTIC):
        return f"a GPU adds in no fixed order without XLA_FLAGS={_DETERMINISTIC[0]}"
    return ""


@functools.cache
def _versions() -> dict[str, str]:
    # Ours from the source: what pip installed once says nothing about a checkout.
    versions = {"odaf": __version__}
    for package in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[package] = importlib.metadata.version(package)
    return versions


@functools.cache
def _processor() -> str:
    """The processor's model: the compiler writes for the instructions that it has."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
