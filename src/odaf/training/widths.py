"""States of learners in arrays wider than they need, so that lanes of different widths can be stacked.

A network is drawn at its own widths and then gets zero weights for the columns that its data set does not have. They
get zero gradients (see `Algorithm.can_be_padded`), so they stay zero, Adam's moments and slow copies with them; taken
out again, the state is that of a training alone. Checkpoints hold it so.
"""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.data.spec import Spec
from odaf.training.run_directory import blank_state

# Of observations and of actions.
Widths = tuple[int, int]


def widths_of(spec: Spec) -> Widths:
    """A data set's own."""
    return spec.obs_dim, spec.act_dim


def with_widths(spec: Spec, widths: Widths) -> Spec:
    """The same task with other sizes; for shapes of states alone."""
    return replace(spec, obs_dim=widths[0], act_dim=widths[1])


class PaddedState:
    """Between a learner's states of one data set's widths and padded ones.

    Args:
        algorithm: the learner.
        spec: of the data set.
        padded: at least as wide.
    """

    def __init__(self, algorithm: Algorithm, spec: Spec, padded: Widths):
        own = widths_of(spec)
        sizes = [(own[0] + more, own[1] + most) for more, most in ((0, 0), (1, 0), (0, 1))]
        shapes = [jax.tree.leaves(blank_state(algorithm, with_widths(spec, size))) for size in sizes]
        axes = [list(_axes(*(each.shape for each in leaf))) for leaf in zip(*shapes, strict=True)]
        self._places = [  # () for what has the same shape in both
            tuple(np.concatenate(list(_places(axis, own, padded))) for axis in leaf)
            if any(observations or actions for _, observations, actions in leaf)
            else ()
            for leaf in axes
        ]
        self._blank = blank_state(algorithm, with_widths(spec, padded))
        self.pad = jax.jit(self._pad)
        self.lane = jax.jit(self._lane)

    def _pad(self, state: Any) -> Any:
        """A state of the data set's widths, wider."""
        blank, structure = jax.tree.flatten(self._blank)
        wide = [
            jnp.zeros(to.shape, to.dtype).at[np.ix_(*places)].set(leaf) if places else leaf
            for leaf, to, places in zip(jax.tree.leaves(state), blank, self._places, strict=True)
        ]
        return jax.tree.unflatten(structure, wide)

    def _lane(self, states: Any, index: Any) -> Any:
        """One of the stacked padded states at its own widths, in memory of its own."""
        leaves, structure = jax.tree.flatten(states)
        own = [
            leaf[index][np.ix_(*places)] if places else leaf[index]
            for leaf, places in zip(leaves, self._places, strict=True)
        ]
        return jax.tree.unflatten(structure, own)


def _axes(own: tuple[int, ...], more: tuple[int, ...], most: tuple[int, ...]) -> Iterator[tuple[int, int, int]]:
    """(size, observations in it, actions in it) of each axis, from its size with one observation or action more."""
    return ((size, one - size, other - size) for size, one, other in zip(own, more, most, strict=True))


def _places(axis: tuple[int, int, int], own: Widths, padded: Widths) -> Iterator[np.ndarray]:
    """Where the entries of an axis lie in the padded one: observations first, then one or two sets of actions."""
    size, observations, actions = axis
    if (observations, actions) == (0, 0):
        yield np.arange(size)
        return
    assert size == observations * own[0] + actions * own[1], f"an axis of {size} is more than observations and actions"
    kinds = [0] * observations + [1] * actions
    starts = itertools.accumulate((padded[kind] for kind in kinds), initial=0)
    for kind, start in zip(kinds, starts, strict=False):
        yield start + np.arange(own[kind])
