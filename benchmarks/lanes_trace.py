"""Where the time of a compiled program goes: a trace of the device, summed by kind of operation.

Kinds are told from the compiler's names, so what it fuses with a product counts as the product. The folder can be
opened with XProf or TensorBoard as well.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import jax

# The first whose words are in an operation's name. What is left works number by number: activations, normalisation,
# optimiser, slow copies.
KINDS = {
    "products": ("dot", "gemm", "cublas", "cutlass", "ynn", "xmma", "wgmma"),
    "random numbers": ("shift-right", "xor", "rng", "threefry"),
    "rows drawn and put back": ("gather", "scatter", "dynamic"),
    "sums": ("reduce",),
    "copies": ("copy", "transpose", "memcpy", "memset"),
}
OTHER = "number by number"
# Their time is that of the operations in them.
_ENCLOSING = ("while", "call", "cond")
_SHOWN = 12


def traced(folder: Path, call: Callable[[], object]) -> dict[str, Any]:
    """What a call spends its time on.

    Args:
        folder: where the trace is written.
        call: of a compiled program; waits for its end.

    Returns:
        Milliseconds by kind of operation, and the operations that take most, each with its calls. Threads and streams
        that work side by side are added up.
    """
    options = jax.profiler.ProfileOptions()
    options.python_tracer_level = 0
    jax.profiler.start_trace(str(folder), profiler_options=options)
    try:
        call()
    finally:
        jax.profiler.stop_trace()
    newest = max(folder.glob("**/*.xplane.pb"), key=lambda file: file.stat().st_mtime)
    return summed(_operations(jax.profiler.ProfileData.from_file(str(newest))))


def summed(operations: Iterable[tuple[str, float]]) -> dict[str, Any]:
    """The same of the (name, nanoseconds) of each call."""
    times: dict[str, float] = defaultdict(float)
    calls: dict[str, int] = defaultdict(int)
    for name, nanoseconds in operations:
        times[name] += nanoseconds / 1e6
        calls[name] += 1
    kinds: dict[str, float] = defaultdict(float)
    for name, taken in times.items():
        kinds[kind_of(name)] += taken
    largest = sorted(times, key=lambda name: -times[name])[:_SHOWN]
    return {
        "milliseconds": dict(sorted(kinds.items(), key=lambda kind: -kind[1])),
        "largest": [{"operation": name, "milliseconds": times[name], "calls": calls[name]} for name in largest],
    }


def kind_of(operation: str) -> str:
    """The kind that a name tells."""
    lowered = operation.lower()
    return next((kind for kind, words in KINDS.items() if any(word in lowered for word in words)), OTHER)


def _operations(data: Any) -> Iterator[tuple[str, float]]:
    """(name, nanoseconds) of each operation on the accelerator, or on the host where there is none."""
    planes = list(data.planes)
    devices = [plane for plane in planes if plane.name.startswith("/device:")]
    for plane in devices or planes:
        lines = list(plane.lines)
        streams = [line for line in lines if line.name.startswith("Stream")]
        for line in streams or lines:
            for event in line.events:
                name = dict(event.stats).get("hlo_op", event.name if devices else None)
                if name is not None and not str(name).startswith(_ENCLOSING):
                    yield str(name), event.duration_ns
