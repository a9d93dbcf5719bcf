"""What can be learnt online, by name."""

from collections.abc import Mapping
from typing import Any

from odaf.behaviour.ant_task import AntTask
from odaf.behaviour.locomotion_task import LocomotionTask
from odaf.behaviour.task import OnlineTask
from odaf.environments.locomotion import TASKS
from odaf.errors import ConfigError

ANT = "ant"
NAMES = (*TASKS, ANT)


def usual_settings(name: str) -> Mapping[str, Any]:
    """Settings of a run, by their names in `OnlineRun`, that the task called `name` is meant to be trained with."""
    return AntTask.usual if name == ANT else LocomotionTask.usual


def online_task(name: str, version: str) -> OnlineTask:
    """The task called `name`.

    Raises:
        ConfigError: there is no such task or version.
    """
    if name not in NAMES:
        raise ConfigError(f"task '{name}' is not known; known are {', '.join(NAMES)}")
    if name != ANT:
        return LocomotionTask(name, version)
    if version != AntTask.version:
        raise ConfigError(f"version '{version}' of ant is not supported; supported is {AntTask.version}")
    return AntTask()
