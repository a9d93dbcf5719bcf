"""Bars on the terminal while work on many rows is going on; nothing elsewhere."""

import contextlib
import sys
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def rows_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A function to call with (rows seen, rows in all); the bar goes away at the end."""
    with _bar(title, "count") as progress:
        yield progress


@contextlib.contextmanager
def share_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A function to call with (done, all there is to do) in any unit; the bar shows the share."""
    with _bar(title, "share") as progress:
        yield progress


@contextlib.contextmanager
def _bar(title: str, shown: str) -> Iterator[Callable[[int, int], None]]:
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return

    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    amount = MofNCompleteColumn() if shown == "count" else TaskProgressColumn()
    columns = (TextColumn("{task.description}"), BarColumn(), amount, TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
