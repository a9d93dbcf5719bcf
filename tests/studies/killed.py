"""A script that measures a small study whose process is killed again and again, for `test_killed_study`.

One process imports everything, which takes seconds, and forks one that measures for every kill.
"""

import builtins
import importlib
import io
import itertools
import json
import os
import random
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from odaf.studies.executor import Here
from odaf.studies.job import Record, Study
from odaf.studies.ledger import Ledger
from odaf.studies.logs import MazeLog
from odaf.studies.news import Display
from odaf.studies.perform import perform
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of

MAZE = Task(
    MazeLog("stitch", repeats=2, episodes=2), Evaluation(every=4, episodes=2), field="maze",
    common=(("hidden_sizes", (4,)), ("batch_size", 8)),
)  # fmt: skip
TRAININGS = [("behaviour-cloning", 0, 8), ("behaviour-cloning", 1, 12), ("behaviour-cloning", 0, 16)]

IMPORTED = (
    *("odaf.algorithms.registry", "odaf.environments.stitch_data", "odaf.evaluation.rollouts", "odaf.runs.evaluate"),
    *("odaf.runs.fit", "odaf.training.fit"),
)


def small_study() -> Study:
    """Three trainings, of which the last goes on where the first ends, and a table."""
    runs = [Training(preset, MAZE, seed, steps, checkpoint_every=2) for preset, seed, steps in TRAININGS]
    phases = phases_of(("both seeds", runs[:2]), ("longer", runs[2:]))
    return Study("small", "small", lambda: phases, {"table.md": _table})


def _table(records: Sequence[Record]) -> str:
    return "".join(f"{record['seed']} {record['steps']} {record['final']['mean_return']}\n" for record in records)


def measure(place: Path) -> None:
    study = small_study()
    perform(Ledger(study, place / "ledger"), study.jobs(), place / "work", Here(), Display("small", io.StringIO()))


def killed_at(place: Path, file: str, moment: int) -> int:
    """The exit status of a process that measures, and is killed at a moment of a file; at 0 it lives, and leaves the
    names of the files that its moments were of."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            place.mkdir(exist_ok=True)
            with (place / "moments.json").open("w") as names:
                passed = _die_at(place, file, moment)
                measure(place)
                json.dump(passed, names)
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _die_at(place: Path, file: str, moment: int) -> list[str]:
    """Lists the moments before and after each call that changes a file below `place`, and kills this process at one.

    What a kill leaves follows from the calls that came before it; a clock would hardly ever hit the microseconds
    between some of them.
    """
    passed: list[str] = []
    left = moment

    def passes(name: str) -> None:
        nonlocal left
        passed.append(name)
        left -= file in name
        if left == 0 and file in name:
            os.kill(os.getpid(), signal.SIGKILL)

    def around(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(path: Any, *arguments: Any, **options: Any) -> Any:
            name = os.readlink(f"/proc/self/fd/{path}") if isinstance(path, int) else os.fspath(path)
            counts = str(place) in name and (function is not open_ or not {*arguments[:1]} <= {"r", "rb", "rt"})
            if counts:
                passes(name)
            result = function(path, *arguments, **options)
            if counts:
                passes(name)
            return result

        return call

    open_ = builtins.open
    builtins.open = io.open = around(open_)
    for name in ("fsync", "replace", "rename", "mkdir", "unlink", "rmdir"):
        setattr(os, name, around(getattr(os, name)))
    return passed


def kills_of(passed: Sequence[str], seed: int) -> list[tuple[str, int]]:
    """Ten moments at which processes that go on from one another are killed, by file and number.

    Seven are spread over all that the unbroken run did, three lie in the writing of a record. A process that goes on
    passes moments of its own too, so none is done before it is killed.
    """
    draw, kills, begun = random.Random(seed), list[tuple[str, int]](), 0
    for number, job in enumerate(small_study().jobs()):
        record = f"{job.name}.json"
        own = [moment for moment, name in enumerate(passed) if record in name]
        points = [0, *sorted(draw.sample(range(1, own[0] - begun), 3 if number == 0 else 2))]
        kills += [("", after - before) for before, after in itertools.pairwise(points)]
        kills.append((record, draw.randint(1, len(own))))
        begun = own[-1] + 1
    return kills


def main(place: Path, seed: int) -> None:
    """Measures at once in one folder, and with ten kills in another; prints what came of it."""
    unbroken, killed = place / "unbroken", place / "killed"
    found: dict[str, Any] = {"unbroken": killed_at(unbroken, "", 0)}
    passed = json.loads((unbroken / "moments.json").read_text())
    found |= {"moments": len(passed), "kills": kills_of(passed, seed)}
    found["statuses"] = [killed_at(killed, *kill) for kill in found["kills"]]
    print(json.dumps({**found, "end": killed_at(killed, "", 0)}))


if __name__ == "__main__":
    # Once for all, and without starting JAX, whose threads a fork does not take along.
    for module in IMPORTED:
        importlib.import_module(module)
    main(Path(sys.argv[1]), int(sys.argv[2]))
