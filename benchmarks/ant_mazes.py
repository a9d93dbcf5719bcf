"""Steps a second of the ant in its mazes, on one core, under random actions, resets included.

A million rows are what a data set of the public kind holds, so a million divided by the figure is what recording one
costs, a policy's share aside. Seconds are those that the process had of the core; the clock's stand beside them.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.machine import machine, write_figures
from odaf.environments.ant_maze import AntMaze

EPISODE = 1000


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a line each, and write the figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=5_000, help="steps in each maze")
    parser.add_argument("--json", type=Path, help="file that the figures are written to")
    options = parser.parse_args(arguments)
    about = machine()
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (options.steps, 8))
    figures: dict[str, Any] = {"steps": options.steps}
    for name in ("umaze", "medium", "large"):
        ant = AntMaze(name, mode="collection", random_start=True)
        began, had = time.perf_counter(), time.process_time()
        for step, action in enumerate(actions):
            if step % EPISODE == 0:
                ant.reset(seed=step)
            ant.step(action)
        clock, processor = time.perf_counter() - began, time.process_time() - had
        of_core, by_clock = options.steps / processor, options.steps / clock
        figures[name] = {"per_second": by_clock, "per_processor_second": of_core}
        print(f"{name}: {of_core:,.0f} steps a second of one core, {by_clock:,.0f} by the clock")
    print(f"{about['cores']} cores, load before {about['load_before']}")
    write_figures(options.json, about, figures)


if __name__ == "__main__":
    main()
