"""What figures were measured on."""

import os
import platform
from pathlib import Path


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
