"""Policies played in processes of their own while the device trains on."""

import multiprocessing
import pickle
import tempfile
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

from odaf.data.derived import Derivation
from odaf.data.spec import Spec
from odaf.errors import ConfigError
from odaf.evaluation.rollouts import RolloutEvaluator, Rollouts
from odaf.runs.side_by_side import evaluator_of
from odaf.runs.workers import begin_beside
from odaf.training.evaluator import Evaluation
from odaf.training.policy import Policy

# What describes an environment to a process that has to build it.
Described = tuple[Rollouts, Spec, tuple[str, ...], Derivation | None]

# In a worker: the evaluator of each description.
_built: dict[bytes, RolloutEvaluator] = {}


class Players:
    """Processes that play policies. They begin when the first policy comes, and end with this object or its process.

    Args:
        processes: how many.
    """

    def __init__(self, processes: int):
        context = multiprocessing.get_context("spawn")
        leave, self._stay = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(processes, mp_context=context, initializer=begin_beside, initargs=(leave,))
        self._policies = tempfile.TemporaryDirectory(prefix="odaf-policies-")
        self._sent = 0

    def submit(self, policy: Policy, described: bytes, directory: Path, step: int) -> "Future[Evaluation]":
        """Begins an evaluation; see `RolloutEvaluator.__call__`."""
        file = Path(self._policies.name) / f"{self._sent}.safetensors"
        self._sent += 1
        policy.save(file)
        return self._pool.submit(_play, described, file, directory.absolute(), step)

    def close(self) -> None:
        """Ends the processes; what they still play is lost."""
        self._stay.close()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._policies.cleanup()


class PlayedBeside:
    """An evaluator whose episodes are played by `Players`.

    Args:
        evaluator: what plays them otherwise; it has examined the environment.
        described: what a process needs to build the like of it.
        players: the processes.

    Raises:
        ConfigError: the environment cannot be sent to another process.
    """

    def __init__(self, evaluator: RolloutEvaluator, described: Described, players: Players):
        self.every, self.rollouts = evaluator.every, evaluator.rollouts
        self._evaluator, self._players = evaluator, players
        try:
            self._described = pickle.dumps(described)
        except Exception as error:  # pickling fails in as many ways as there are objects
            raise ConfigError(
                f"evaluate: {evaluator.rollouts.name} cannot be sent to another process ({error}); train with workers=1"
            ) from None

    def __call__(self, policy: Policy, directory: Path, step: int) -> Evaluation:
        """Plays in this process."""
        return self._evaluator(policy, directory, step)

    def submit(self, policy: Policy, directory: Path, step: int) -> "Future[Evaluation]":
        """Plays in one of the others; here if the policy is of a class that no file can hold."""
        try:
            return self._players.submit(policy, self._described, directory, step)
        except ConfigError:
            done: Future[Evaluation] = Future()
            done.set_result(self(policy, directory, step))
            return done

    def to_dict(self) -> dict[str, Any]:
        return self._evaluator.to_dict()

    def close(self) -> None:
        """Closes what this process has built; the players are closed by whoever made them."""
        self._evaluator.close()


def _play(described: bytes, file: Path, directory: Path, step: int) -> Evaluation:
    if described not in _built:
        rollouts, spec, names, derivation = pickle.loads(described)  # our parent's own
        _built[described] = evaluator_of(rollouts, spec, names, derivation)
    try:
        return _built[described](Policy.load(file), directory, step)
    finally:
        file.unlink(missing_ok=True)
