"""Asking a policy for the actions of many episodes at once, with its memory and with rows it has no answer for."""

import contextlib
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np

from odaf.errors import DatasetError, DivergenceError
from odaf.training.policy import Policy


@runtime_checkable
class Stepwise(Protocol):
    """A policy that is told when episodes begin and what they earn, such as `odaf.Policy`, so that it may remember."""

    def begin(self, rows: int, /) -> Any: ...

    def act(self, carry: Any, observations: np.ndarray, /) -> tuple[np.ndarray, Any]: ...

    def observe(self, carry: Any, rewards: np.ndarray, /) -> Any: ...


Acting = Callable[[np.ndarray], np.ndarray] | Stepwise


class FromTheStart:
    """A policy on readings that acts in every step of an episode, as an environment asks for.

    In the first steps, for which there is no observation because nothing lies before them, the middle of the action
    bounds is played. Readings of which no observation can be computed count as an action that is not finite.

    Args:
        policy: it has a derivation.
    """

    def __init__(self, policy: Policy):
        self._policy = policy
        self._middle = (0.5 * (np.asarray(policy.action_low) + np.asarray(policy.action_high))).astype(np.float32)

    def begin(self, rows: int) -> Any:
        return self._policy.begin(rows)

    def act(self, carry: Any, observations: np.ndarray) -> tuple[np.ndarray, Any]:
        try:
            actions, carry = self._policy.act(carry, observations)
        except DatasetError as error:
            raise DivergenceError(str(error)) from error
        if np.isnan(actions).any():
            actions = np.where(np.isnan(actions), self._middle, actions)
            carry = self._policy.acted(carry, actions)
        return actions, carry

    def observe(self, carry: Any, rewards: np.ndarray) -> Any:
        return self._policy.observe(carry, rewards)


class Player:
    """Asks a policy for actions and tells it rewards; keeps its carry, if it has any, in between."""

    def __init__(self, policy: Acting, episodes: int):
        if isinstance(policy, Policy) and policy.derivation is not None:
            policy = FromTheStart(policy)
        self._policy = policy
        self._carry = policy.begin(episodes) if isinstance(policy, Stepwise) else ()

    def act(self, observations: np.ndarray, running: np.ndarray) -> np.ndarray:
        """Actions of all rows; NaN in the rows of a policy that has no finite answer to what it sees there."""
        try:
            actions, self._carry = self._ask(self._carry, observations)
            return actions
        except DivergenceError:
            pass
        # Some row is to blame. Each is asked with a batch of its own, of the same size, so nothing is compiled anew.
        rows, found = len(observations), {}
        for index in np.flatnonzero(running).tolist():
            alone = np.full(rows, index)
            with contextlib.suppress(DivergenceError):
                carry = jax.tree.map(lambda leaf, alone=alone: leaf[alone], self._carry)
                found[index] = self._ask(carry, observations[alone])
        nothing = np.full(next((actions.shape[1] for actions, _ in found.values()), 1), np.nan, np.float32)
        carries = [
            jax.tree.map(lambda leaf: leaf[0], found[index][1])
            if index in found
            else jax.tree.map(lambda leaf, index=index: leaf[index], self._carry)
            for index in range(rows)
        ]
        self._carry = jax.tree.map(lambda *leaves: np.stack(leaves), *carries)
        return np.stack([found[index][0][0] if index in found else nothing for index in range(rows)])

    def observe(self, rewards: np.ndarray) -> None:
        if isinstance(self._policy, Stepwise):
            self._carry = self._policy.observe(self._carry, rewards)

    def _ask(self, carry: Any, observations: np.ndarray) -> tuple[np.ndarray, Any]:
        if isinstance(self._policy, Stepwise):
            return self._policy.act(carry, observations)
        return np.asarray(self._policy(observations)), ()
