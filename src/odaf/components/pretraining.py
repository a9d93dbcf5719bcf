"""Pre-training of a side model on a log: rows split by episode, and Adam on random batches of them."""

import functools
from collections.abc import Callable
from typing import Any, Literal, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError, DivergenceError

STRETCH = 1_000

Model = TypeVar("Model", bound=PyTree)
Rows = tuple[Array, Array, Array]  # states, actions, next states
Progress = Callable[[int, int], None]
Schedule = Literal["cosine", "constant"]


def split_rows(
    dataset: Dataset, share: float, key: PRNGKeyArray, model: str, remedy: str
) -> tuple[np.ndarray, np.ndarray]:
    """Row indices of the training and hold-out episodes, at least one on each side; a single episode is cut in time.

    Args:
        dataset: the log. Rows whose successor was not recorded are left out.
        share: of the episodes, held out.
        key: random key that chooses them.
        model: what is trained, named in error messages.
        remedy: how to do without it, for the same messages.

    Raises:
        DatasetError: the log has fewer than two rows whose successor is known.
    """
    # a terminated row without a recorded successor repeats its own state; it would teach "no change"
    known = ~(dataset.terminated & np.all(dataset.observations == dataset.next_observations, axis=1))
    rows_by_episode = np.split(np.arange(len(dataset)), dataset.episode_starts[1:])
    usable = [rows[known[rows]] for rows in rows_by_episode if np.any(known[rows])]
    if sum(len(rows) for rows in usable) < 2:
        raise DatasetError(
            f"{model}: of {len(dataset):,} rows {int(known.sum())} have a logged successor; at least 2 must; "
            f"log the state after each action (next_observations), or {remedy}"
        )
    if len(usable) == 1:
        rows = usable[0]
        cut = min(max(1, int(len(rows) * (1.0 - share))), len(rows) - 1)
        return rows[:cut], rows[cut:]
    order = np.asarray(jr.permutation(key, len(usable)))
    count = min(max(1, round(share * len(usable))), len(usable) - 1)
    train, holdout = ([usable[index] for index in np.sort(side)] for side in (order[count:], order[:count]))
    return np.concatenate(train), np.concatenate(holdout)


def normalised_rows(dataset: Dataset, normaliser: Normaliser, rows: np.ndarray) -> Rows:
    """Columns of some rows as a learner sees them, on the device."""
    low, high = dataset.action_low, dataset.action_high
    actions = 2.0 * (dataset.actions[rows] - low) / (high - low) - 1.0
    return (
        jnp.asarray(normaliser.normalise(dataset.observations[rows]), dtype=jnp.float32),
        jnp.asarray(actions, dtype=jnp.float32),
        jnp.asarray(normaliser.normalise(dataset.next_observations[rows]), dtype=jnp.float32),
    )


def minimise(
    model: Model,
    loss: Callable[[Model, Rows, PRNGKeyArray], Float[Array, ""]],
    rows: Rows,
    *,
    trainable: PyTree,
    steps: int,
    batch_size: int,
    learning_rate: float,
    schedule: Schedule,
    key: PRNGKeyArray,
    progress: Progress,
    what: str,
    remedy: str,
    bootstraps: Int[Array, "members rows"] | None = None,
) -> tuple[Model, float]:
    """Adam on batches drawn with replacement.

    Args:
        model: where to start.
        loss: of a model, a batch and a key.
        rows: what batches are drawn from.
        trainable: a tree of booleans in the model's structure; the rest stays as it is.
        steps: gradient steps.
        batch_size: rows a batch, for every member if there are `bootstraps`.
        learning_rate: step size at the start.
        schedule: "cosine" lets it fall to zero over the steps, "constant" keeps it.
        key: random key for batches and losses.
        progress: called with (steps done, steps in all) after every stretch.
        what: the model's name, for error messages.
        remedy: what to do if the loss diverges, for the same messages.
        bootstraps: row indices of each member's own sample; batches then have a leading axis of members.

    Returns:
        The model and the mean training loss of the last stretch.

    Raises:
        DivergenceError: the training loss stopped being finite.
    """
    rate = optax.cosine_decay_schedule(learning_rate, steps) if schedule == "cosine" else learning_rate
    optimiser = optax.adam(rate)
    split = functools.partial(eqx.partition, filter_spec=trainable)
    moments = optimiser.init(split(model)[0])

    @eqx.filter_jit(donate="all-except-first")
    def stretch(data, model, moments, indices) -> Any:
        def step(carry, index):
            model, moments = carry
            key_draw, key_loss = jr.split(jr.fold_in(key, index))
            shape = (batch_size,) if bootstraps is None else (bootstraps.shape[0], batch_size)
            picked = jr.randint(key_draw, shape, 0, data[0].shape[0])
            if bootstraps is not None:
                picked = jnp.take_along_axis(bootstraps, picked, axis=1)
            batch = tuple(column[picked] for column in data)
            parameters, rest = split(model)
            value, gradient = jax.value_and_grad(lambda p: loss(eqx.combine(p, rest), batch, key_loss))(parameters)
            updates, moments = optimiser.update(gradient, moments, parameters)
            return (eqx.combine(optax.apply_updates(parameters, updates), rest), moments), value

        return jax.lax.scan(step, (model, moments), indices)

    done, training_loss = 0, float("nan")
    while done < steps:
        count = min(STRETCH, steps - done)
        (model, moments), losses = stretch(rows, model, moments, jnp.arange(done, done + count))
        done += count
        training_loss = float(jnp.mean(losses))
        if not np.isfinite(float(losses[-1])):
            raise DivergenceError(f"{what}: the training loss is not finite after {done} steps; {remedy}")
        progress(done, steps)
    return model, training_loss
