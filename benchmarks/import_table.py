"""How long a million-row Parquet file takes to become a `Dataset`, and how much memory at most.

The file holds 17 observations, 6 actions, a reward, an episode id, an end flag and the time, in double precision. It is
written first; reading, checking and building happen in a process of their own. Its peak, libraries and all, is compared
with the size of the arrays that the data set keeps in memory, which are in single precision.
"""

import argparse
import json
import multiprocessing
import os
import platform
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

OBSERVATIONS = [f"observation {index}" for index in range(17)]
ACTIONS = [f"action {index}" for index in range(6)]
EPISODE_STEPS = 1_000


def write(path: Path, rows: int) -> None:
    """A log of random numbers; every second episode terminates."""
    rng = np.random.default_rng(0)
    step = np.arange(rows)
    columns = {name: rng.normal(size=rows) for name in OBSERVATIONS}
    columns |= {name: rng.uniform(-1.0, 1.0, rows) for name in ACTIONS}
    columns |= {
        "reward": rng.normal(size=rows),
        "episode": step // EPISODE_STEPS,
        "ended": step % (2 * EPISODE_STEPS) == 2 * EPISODE_STEPS - 1,
        "time": step * 0.02,
    }
    pl.DataFrame(columns).write_parquet(path)


def import_file(path: Path, figures) -> None:
    """Reads, runs every check, builds; puts what it took into the queue `figures`."""
    from odaf.data import Dataset
    from odaf.data.checks import check_log
    from odaf.data.readers import tables

    libraries = peak_bytes()
    began, busy = time.perf_counter(), time.process_time()
    log = tables.read(
        path,
        observations=OBSERVATIONS,
        actions=ACTIONS,
        reward="reward",
        episode="episode",
        terminated="ended",
        time="time",
        action_bounds=(-1.0, 1.0),
    )
    read = time.perf_counter() - began
    check_log(log)
    checked = time.perf_counter() - began
    dataset = Dataset.from_log(log)
    seconds = time.perf_counter() - began
    busy = time.process_time() - busy
    arrays = (dataset.observations, dataset.next_observations, dataset.actions, dataset.rewards)
    size = sum(array.nbytes for array in (*arrays, dataset.terminated, dataset.truncated))
    peak = peak_bytes()
    figures.put(
        {
            "seconds": seconds,
            "cpu_seconds": busy,
            "read_seconds": read,
            "check_seconds": checked - read,
            "transitions": len(dataset),
            "data_bytes": size,
            "peak_bytes": peak,
            "libraries_bytes": libraries,
            "peak_share": peak / size,
        }
    )


def peak_bytes() -> int:
    """The most memory this process has held."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def main(arguments: list[str] | None = None) -> None:
    """Write, import in a fresh process, print the figures, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=1_000_000, help="rows of the file")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)

    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        # A process inherits the peak of the one that starts it, so this one must stay small.
        writer = context.Process(target=write, args=(path, options.rows))
        writer.start()
        writer.join()
        file_bytes = path.stat().st_size
        figures = context.Queue()
        process = context.Process(target=import_file, args=(path, figures))
        process.start()
        found = figures.get()
        process.join()
    print(
        f"{options.rows:,} rows, {file_bytes / 1e6:.0f} MB Parquet: imported in {found['seconds']:.1f} s, "
        f"{found['cpu_seconds']:.1f} s of them computing"
    )
    print(
        f"peak memory {found['peak_bytes'] / 1e6:.0f} MB, {found['peak_share']:.2f} times the data set's "
        f"{found['data_bytes'] / 1e6:.0f} MB ({found['libraries_bytes'] / 1e6:.0f} MB of it are libraries)"
    )
    if options.json:
        machine = {"platform": platform.platform(), "cores": os.cpu_count(), "polars": pl.__version__}
        options.json.parent.mkdir(parents=True, exist_ok=True)
        content = {"machine": machine, "rows": options.rows, "file_bytes": file_bytes, **found}
        options.json.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
