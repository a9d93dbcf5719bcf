"""A bar on the terminal while many rows are looked at; nothing elsewhere."""

import contextlib
import sys
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def rows_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A function to call with (rows seen, rows in all); the bar goes away at the end."""
    if not sys.stderr.isatty():
        yield lambda seen, total: None
        return

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=None)
        yield lambda seen, total: progress.update(task, completed=seen, total=total)
