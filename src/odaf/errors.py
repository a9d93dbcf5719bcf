"""The exceptions a user of odaf can meet; every message says what was expected, what came, where, and what to do.

A message names an option as Python writes it: `reward=`, or `reward=0.0` with a value. The command line shows the same
message with its own spelling (`odaf.cli.spelling`), so that nobody has to write it twice.
"""

import re
from collections.abc import Iterable, Sequence
from typing import Any

# An argument as a call writes it; not the `==` of a comparison, nor a part of a longer word or of a path, such
# as that of one run among several, runs/poor,actor_learning_rate=0.0001.
OPTION = re.compile(r"(?<![\w.,\"'/-])([a-z][a-z0-9_]*)=(?!=)")


class OdafError(Exception):
    """Any mistake odaf can explain. The command line prints its message without a traceback and exits with 2.

    Args:
        message: what is wrong and where; with `remedies`, without a way out of its own.
        remedies: alternative ways out, the most advisable first; at least one names no option. Code that several
            layouts share gives them here: the message shows those whose options exist where the user is, see `offer`.

    Attributes:
        remedies: as given.
    """

    def __init__(self, message: str = "", *more: Any, remedies: Sequence[str] = ()):
        super().__init__(message, *more)
        self.remedies = tuple(remedies)
        self._offered: frozenset[str] | None = None

    def offer(self, options: Iterable[str]) -> None:
        """Tells the error which options the user can give where it arose; remedies that need others are not shown."""
        offered = frozenset(options)
        self._offered = offered if self._offered is None else self._offered & offered

    def takeable(self) -> tuple[str, ...]:
        """The remedies that can be taken: all, unless `offer` said which options there are."""
        return tuple(
            remedy
            for remedy in self.remedies
            if self._offered is None or self._offered.issuperset(OPTION.findall(remedy))
        )

    def __str__(self) -> str:
        message, remedies = super().__str__(), self.takeable()
        return f"{message}; {', or '.join(remedies)}" if remedies else message


class OdafWarning(UserWarning):
    """Something that odaf goes on with, and that the user should know; the command line prints its message alone."""


class DatasetError(OdafError):
    """Logged data that cannot be used as it is: the message names file, field, first rows and remedy."""


class ConfigError(OdafError):
    """A setting that does not exist, does not fit its neighbours, or needs something that is not installed."""


class CheckpointError(OdafError):
    """A checkpoint or run directory that is missing, damaged, or belongs to something else."""


class DivergenceError(OdafError):
    """Training left the range that the rewards allow, and the run was told to stop when that happens."""
