"""Seconds and memory from a file to columns on the device: load, check, normalise, put on the device.

A fresh process does the work, so that nothing is warm but the file system's cache. Its peak memory is measured above
what the process held once the libraries were loaded, and given as a multiple of the data's own bytes. The processor's
seconds are given beside those of the clock, because they do not depend on what else the machine does.
"""

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROWS, OBS_DIM, ACT_DIM = 1_000_000, 17, 6

CHILD = """
import json, os, resource, sys, time
import jax, jax.numpy as jnp
from odaf.data import Dataset, Normaliser, device_columns
from odaf.data import checks, convert, dataset, episodes, readers, storage
jnp.zeros(8).block_until_ready()
pages = int(open("/proc/self/statm").read().split()[1])
before = pages * os.sysconf("SC_PAGESIZE")
clock, used = time.perf_counter(), time.process_time()
times = {}

def lap(name):
    global clock, used
    now, spent = time.perf_counter(), time.process_time()
    times[name] = {"seconds": now - clock, "processor_seconds": spent - used}
    clock, used = now, spent

data = Dataset.load(sys.argv[1])
lap("load")
report = data.check()
lap("check")
columns = jax.block_until_ready(device_columns(data, Normaliser.fit(data.observations)))
lap("device")
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
size = sum(getattr(data, name).nbytes for name in (*dataset.COLUMNS, "episode_starts", "action_low", "action_high"))
print(json.dumps({
    "steps": times, "peak_bytes": peak - before, "data_bytes": size, "usable": report.usable,
    "device": str(jax.devices()[0]), "jax": jax.__version__,
}))
"""


def write(path: Path, rows: int, layout: str) -> None:
    """Episodes of a thousand steps of a random walk."""
    from odaf.data import Dataset, convert

    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.normal(size=(rows + 1, OBS_DIM)), axis=0).astype(np.float32)
    dataset = Dataset.from_arrays(
        walk[:-1],
        rng.uniform(-1, 1, (rows, ACT_DIM)).astype(np.float32),
        rng.normal(size=rows).astype(np.float32),
        walk[1:],
        truncated=np.arange(rows) % 1_000 == 999,
        action_bounds=(-1.0, 1.0),
    )
    if layout == "d4rl":
        convert.to_d4rl(dataset, path)
    else:
        dataset.save(path)


def main(arguments: list[str] | None = None) -> None:
    """Measure both HDF5 layouts, print one line each, and write the figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=ROWS, help="transitions")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)

    figures: dict[str, dict] = {}
    for layout in ("odaf", "d4rl"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "log.hdf5"
            write(path, options.rows, layout)
            done = subprocess.run([sys.executable, "-c", CHILD, str(path)], capture_output=True, text=True, check=True)
        found = figures[layout] = json.loads(done.stdout.splitlines()[-1])
        found["times_the_data"] = found["peak_bytes"] / found["data_bytes"]
        for unit in ("seconds", "processor_seconds"):
            found[unit] = sum(step[unit] for step in found["steps"].values())
        steps = ", ".join(f"{name} {step['seconds']:.1f}" for name, step in found["steps"].items())
        print(
            f"{layout}: {options.rows:,} transitions in {found['seconds']:.1f} s ({steps}), "
            f"{found['processor_seconds']:.1f} s of processor, peak memory {found['times_the_data']:.2f} times the data"
        )
    if options.json:
        machine = {"platform": platform.platform(), **{key: figures["odaf"].pop(key) for key in ("device", "jax")}}
        options.json.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"machine": machine, "transitions": options.rows, "layouts": figures}, indent=2)
        options.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
