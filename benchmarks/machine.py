"""What figures were measured on, and the file that they are kept in."""

import json
import os
import platform
from pathlib import Path
from typing import Any


def machine() -> dict[str, object]:
    """System, processor, cores that may be used, JAX and its device, and how busy the machine was before."""
    import jax

    processor = platform.processor()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), processor)
    return {
        "platform": platform.platform(),
        "processor": processor,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "device": str(jax.devices()[0]),
        "jax": jax.__version__,
        "load_before": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


def write_figures(path: Path | None, about: dict[str, object], figures: dict[str, Any]) -> None:
    """A JSON file of the figures under what they were measured on; None writes nothing."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"machine": about, **figures}, indent=2) + "\n", encoding="utf-8")
