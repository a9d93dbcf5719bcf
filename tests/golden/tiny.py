"""Small inputs that the tests share: a batch, a dataset, networks with random parameters everywhere."""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import dtypes

from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.ensemble_state import EnsembleState
from odaf.algorithms.terms import Context
from odaf.components.critics import CriticEnsemble
from odaf.components.dynamics import DynamicsConfig, DynamicsModel, untrained
from odaf.components.networks import MLP
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions

Tree = TypeVar("Tree")

OBS_DIM, ACT_DIM, ROWS = 3, 2, 6

SPEC = Spec(
    obs_dim=OBS_DIM,
    act_dim=ACT_DIM,
    action_low=(-1.0, -1.0),
    action_high=(1.0, 1.0),
    reward_min=-1.0,
    reward_max=2.0,
    ever_terminates=True,
    max_episode_length=20,
)

SMALL = {"num_critics": 3, "hidden_sizes": (5, 4), "batch_size": ROWS}


def floats(array) -> jax.Array:
    """On the device, in double precision where that is on and in single precision elsewhere."""
    return jnp.asarray(np.asarray(array, dtypes.canonicalize_dtype(float)))


def in_double(tree: Tree) -> Tree:
    """The same numbers in double precision, where that is on."""
    return jax.tree.map(lambda leaf: floats(leaf) if jnp.issubdtype(leaf.dtype, jnp.inexact) else leaf, tree)


def batch(rows: int = ROWS, seed: int = 0, extras: tuple[str, ...] = ()) -> Transitions:
    """Random rows; every third one is a true end. Further columns are actions, or numbers of which the ends have 0."""
    rng = np.random.default_rng(seed)
    return Transitions(
        floats(rng.normal(size=(rows, OBS_DIM))),
        floats(rng.uniform(-1.0, 1.0, (rows, ACT_DIM))),
        floats(rng.uniform(-1.0, 2.0, rows)),
        floats(rng.normal(size=(rows, OBS_DIM))),
        floats(np.arange(rows) % 3 == 2),
        {name: floats(_extra(name, rows)) for name in extras},
    )


def _extra(name: str, rows: int) -> np.ndarray:
    if name == "next_actions":
        return np.random.default_rng(1).uniform(-1.0, 1.0, (rows, ACT_DIM))
    return (np.arange(rows) % 3 != 2).astype(float)


def filled(structure: Tree, seed: int = 0, size: float = 0.6) -> Tree:
    """A tree of arrays, or of shapes only, with every floating-point leaf replaced by `size` times normal noise."""
    rng = np.random.default_rng(seed)

    def fill(leaf):
        if jnp.issubdtype(leaf.dtype, jnp.inexact):
            return floats(size * rng.normal(size=leaf.shape))
        return jnp.asarray(np.zeros(leaf.shape, leaf.dtype))

    return jax.tree.map(fill, structure)


@functools.cache
def _structure(build: Callable, settings):
    """Shapes of what `build(settings)` makes; nothing is compiled."""
    return eqx.filter_eval_shape(lambda: build(settings))


def _initial(learner: EnsembleSAC) -> EnsembleState:
    key = jax.random.key(0)
    return learner.init(key, SPEC, learner.untrained(key, SPEC))


def _untrained(config: DynamicsConfig) -> DynamicsModel:
    return untrained(config, jax.random.key(0), OBS_DIM, ACT_DIM)


def state_of(learner: EnsembleSAC, *, models=(), bounds=(-np.inf, np.inf), size: float = 0.6) -> EnsembleState:
    """A learner's state at step 0 with four different random networks and a temperature of a half.

    Args:
        learner: whose state.
        models: one entry a term, its model; () leaves every term without one.
        bounds: of the targets.
        size: of the networks' parameters.
    """
    shape = _structure(_initial, learner)
    empty = filled(shape, size=0.0)
    online = filled(CriticEnsemble(shape.critics.now, shape.priors), 3, size)
    terms = learner.active_terms
    return dataclasses.replace(
        empty,
        actor=Trained(filled(shape.actor.now, 1, size), filled(shape.actor.slow, 2, size), empty.actor.moments),
        critics=Trained(online.networks, filled(shape.critics.slow, 4, size), empty.critics.moments),
        priors=online.priors,
        log_temperature=Trained(floats(np.log(0.5)), None, empty.log_temperature.moments),
        target_entropy=floats(-ACT_DIM if learner.target_entropy is None else learner.target_entropy),
        reward_scale=floats(1.0),
        value_bounds=floats(bounds),
        terms=in_double(
            tuple(term.init(model) for term, model in zip(terms, models or ((),) * len(terms), strict=True))
        ),
    )


def twin_delayed_state(learner: Any, step: int = 0) -> Any:
    """A state of TD3 or a relative with four different random networks, and random models of the log."""
    key, other = jax.random.key(0), jax.random.key(1)
    shape = eqx.filter_eval_shape(lambda: learner.init(key, SPEC, learner.untrained(other, SPEC)))
    empty = filled(shape, size=0.0)
    actor, critics = shape.actor, shape.critics
    return dataclasses.replace(
        empty,
        step=empty.step + step,
        actor=Trained(filled(actor.now, 1), filled(actor.slow, 2), empty.actor.moments),
        critics=Trained(filled(critics.now, 3), filled(critics.slow, 4), empty.critics.moments),
        models=filled(shape.models, 5),
    )


def levelled(networks: MLP, values: np.ndarray) -> MLP:
    """Critics whose medians over these rows, of which they had the values, are 0: each is the lowest one somewhere."""
    *hidden, output = networks.biases
    return dataclasses.replace(networks, biases=(*hidden, output - floats(np.median(values, axis=1))[:, None]))


def critics(norm: str = "layer", num_critics: int = 3) -> CriticEnsemble:
    """Critics with random parameters."""
    return state_of(EnsembleSAC(**{**SMALL, "num_critics": num_critics, "critic_norm": norm})).online_critics


def context_of(state: EnsembleState, batch: Transitions) -> Context:
    """What a learner shows to its terms."""
    return Context(
        batch=batch,
        actor=state.actor.now,
        slow_actor=state.slow_actor,
        critics=state.online_critics,
        target_critics=state.target_critics,
        value_bounds=state.value_bounds,
        step=state.step,
    )


def dynamics_config(**fields) -> DynamicsConfig:
    """A dynamics model of a few units."""
    return DynamicsConfig(**{"hidden_sizes": (5, 4), "latent_dim": 3, "members": 3, "elites": 3, **fields})


def dynamics_model(config: DynamicsConfig, seed: int = 0, size: float = 0.6) -> DynamicsModel:
    """A dynamics model with random parameters and an output scale around one."""
    model = filled(_structure(_untrained, config), seed, size)
    scale = 1.0 + 0.3 * np.random.default_rng(seed).uniform(-1.0, 1.0, OBS_DIM)
    return eqx.tree_at(lambda m: m.scale, model, floats(scale))


@contextlib.contextmanager
def exactly() -> Iterator[None]:
    """Double precision, op by op: what is compiled is small and shared by all tests, `jax.lax.map` is a plain loop."""

    def loop(function, rows):
        count = len(jax.tree.leaves(rows)[0])
        results = [function(jax.tree.map(lambda leaf, row=row: leaf[row], rows)) for row in range(count)]
        return jax.tree.map(lambda *parts: jnp.stack(parts), *results)

    with jax.enable_x64(True), pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax.lax, "map", loop)
        yield


@contextlib.contextmanager
def recorded(kind: str = "normal") -> Iterator[list[np.ndarray]]:
    """Every array that `jax.random.<kind>` draws inside, in order; for code outside of `jax.jit`."""
    drawn: list[np.ndarray] = []
    original = getattr(jax.random, kind)

    def draw(*arguments, **options):
        drawn.append(np.asarray(value := original(*arguments, **options)))
        return value

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax.random, kind, draw)
        yield drawn


def slope_along(function: Callable, tree, direction, width: float = 1e-6) -> float:
    """Central difference of a NumPy function of a tree of arrays, along a direction of the same structure."""

    def moved(sign: float):
        return jax.tree.map(lambda leaf, way: np.asarray(leaf) + sign * width * way, tree, direction)

    return float((function(moved(1.0)) - function(moved(-1.0))) / (2.0 * width))


def random_direction(tree, seed: int = 0):
    """Normal noise in the structure of a tree."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: rng.normal(size=leaf.shape), tree)


def assert_slopes(gradient, function: Callable, tree, *, directions: int = 2, rtol: float = 1e-5) -> None:
    """The gradient agrees with central differences of a NumPy function along random directions."""
    for seed in range(directions):
        way = random_direction(tree, seed)
        pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(way), strict=True)
        found = float(sum(np.sum(np.asarray(g) * w) for g, w in pairs))
        np.testing.assert_allclose(found, slope_along(function, tree, way), rtol=rtol)


def all_zero(tree) -> bool:
    """Whether every number in a tree of arrays is exactly 0."""
    return all(not np.any(np.asarray(leaf)) for leaf in jax.tree.leaves(tree))


def each_nonzero(tree) -> bool:
    """Whether no array in a tree is zero throughout."""
    return all(np.any(np.asarray(leaf)) for leaf in jax.tree.leaves(tree))


def assert_same_bits(first, second) -> None:
    """Every array of one tree equals its partner in the other."""
    for ours, theirs in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def assert_close(first, second, *, rtol: float = 0.0, atol: float = 0.0) -> None:
    """Every array of one tree is close to its partner in the other."""
    for ours, theirs in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=atol)


def linear_dataset(episodes: int = 20, length: int = 25, seed: int = 0, noise: float = 0.0) -> Dataset:
    """Rows of a linear system s' = s A^T + a B^T (+ noise) under random actions; episodes end by time-out."""
    rng = np.random.default_rng(seed)
    a = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 0.1], [0.0, 0.1, 0.7]])
    b = np.array([[0.5, 0.0], [0.0, 0.5], [0.3, -0.3]])
    columns: dict[str, list] = {"s": [], "a": [], "n": [], "t": []}
    for _ in range(episodes):
        state = rng.normal(size=OBS_DIM)
        for step in range(length):
            action = rng.uniform(-1.0, 1.0, ACT_DIM)
            after = a @ state + b @ action + noise * rng.normal(size=OBS_DIM)
            for name, value in zip("sant", (state, action, after, step == length - 1), strict=True):
                columns[name].append(value)
            state = after
    observations, actions, after, ends = (np.array(columns[name]) for name in "sant")
    return Dataset.from_arrays(
        observations,
        actions,
        observations[:, 0],
        next_observations=after,
        truncated=ends,
        action_bounds=(-1.0, 1.0),
    )
