"""Training of an ensemble of transitions, its error on episodes it never saw, and whether its spread covers them."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from odaf.components.dynamics.transition_ensemble import TransitionEnsemble, init_transition_ensemble
from odaf.components.fitting import EarlyStopping, Fitted, Progress, bootstrap_rows, fit, of_rows
from odaf.components.pretraining import HOLDOUT_ROWS, normalised_rows, split_rows
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError

LEAST_STEPS = 1_000  # of an epoch
SMALLEST_STD = 1e-12  # an input that varies less is not divided
COVERAGES = (0.5, 0.9)
LOW_COVERAGE = 0.7  # of the intervals that should hold 0.9: less is worth a warning

Columns = tuple[Array, Array, Array, Array]  # states, actions, rewards, next states
Decayed = tuple[TransitionEnsemble, Float[Array, " layers"]]


@dataclasses.dataclass(frozen=True)
class EnsembleConfig:
    """Sizes and training of an ensemble of transitions."""

    hidden_sizes: tuple[int, ...] = (200, 200, 200, 200)
    """Widths of the hidden layers of each member."""
    members: int = 7
    """Networks trained, each on a bootstrap sample of its own."""
    elites: int = 5
    """Networks that answer, those with the lowest hold-out error."""
    epochs: int = 100
    """Epochs at most, with a check of the hold-out error after each."""
    epoch_steps: int | None = None
    """Gradient steps an epoch; None takes as many as show all rows once, and 1,000 at least."""
    patience: int = 5
    """Epochs without a better member after which training stops; each member is kept as it was at its best."""
    least_gain: float = 0.01
    """Share of its lowest error that a member must gain to count as better."""
    batch_size: int = 256
    """Rows a gradient step and member."""
    learning_rate: float = 1e-3
    """Step size of Adam."""
    weight_decay: tuple[float, ...] = (2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4)
    """w of the weights of each layer, from the first on; the last is the output layer's and that of layers beyond."""
    holdout: float = 0.05
    """Share of the episodes kept out of training: elites, early stopping and the report go by them."""

    def __post_init__(self) -> None:
        for field in ("members", "elites", "epochs", "epoch_steps", "patience", "batch_size"):
            count = getattr(self, field)
            if count is not None and count < 1:
                raise ConfigError(f"dynamics.{field}={count} must be at least 1")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ConfigError(f"dynamics.hidden_sizes={self.hidden_sizes} must be one or more widths of at least 1")
        if self.elites > self.members:
            raise ConfigError(
                f"dynamics.elites={self.elites} cannot be kept of dynamics.members={self.members}; train more members"
            )
        if not 0.0 <= self.least_gain < 1.0:
            raise ConfigError(f"dynamics.least_gain={self.least_gain} must lie in [0, 1)")
        if not self.weight_decay or min(self.weight_decay) < 0.0:
            raise ConfigError(f"dynamics.weight_decay={self.weight_decay} must hold one number or more, none negative")
        if not 0.0 < self.holdout < 1.0:
            raise ConfigError(
                f"dynamics.holdout={self.holdout} must lie between 0 and 1: without episodes to check on, "
                "nobody knows whether the model is better than none"
            )

    def untrained(self, key: PRNGKeyArray, obs_dim: int, act_dim: int) -> TransitionEnsemble:
        """Members as drawn, in the structure that `fit_transitions` returns."""
        return init_transition_ensemble(key, obs_dim, act_dim, self.hidden_sizes, self.members, self.elites)

    def decays(self) -> tuple[float, ...]:
        """w of each layer."""
        layers = len(self.hidden_sizes) + 1
        inner = (*self.weight_decay[:-1], *[self.weight_decay[-1]] * layers)[: layers - 1]
        return *inner, self.weight_decay[-1]


def fit_transitions(
    config: EnsembleConfig,
    dataset: Dataset,
    normaliser: Normaliser,
    key: PRNGKeyArray,
    progress: Progress,
    *,
    remedy: str = "take a learner that needs no model, such as td3-bc",
) -> tuple[TransitionEnsemble, dict[str, Any]]:
    """Train the members on most episodes and measure them on the rest.

    Args:
        config: sizes and training of the members.
        dataset: the log; whole episodes go to one side. Rows whose successor was not recorded are left out.
        normaliser: observation scaling of the learner that will use the model.
        key: random key for the split, the initial networks, the bootstrap samples and the batches.
        progress: called with (steps done, steps in all) after every epoch.
        remedy: how to do without a model, for error messages.

    Returns:
        The frozen ensemble, and a report on the held-out rows: mean squared error of the elites' mean in normalised
        units beside that of "no change", of the reward beside that of the mean reward, and the share of targets inside
        the central 50 % and 90 % of what the elites predict together, over all and by dimension, the reward last.

    Raises:
        DivergenceError: the training loss stopped being finite.
        DatasetError: the log has fewer than two rows whose successor is known.
    """
    key_split, key_init, key_bootstrap, key_train = jr.split(key, 4)
    train, holdout = split_rows(dataset, config.holdout, key_split, "dynamics model", remedy)
    chosen = np.concatenate([train, holdout])
    states, actions, next_states = normalised_rows(dataset, normaliser, chosen)
    columns = (states, actions, jnp.asarray(dataset.rewards[chosen], jnp.float32), next_states)
    total, last = len(chosen), min(len(chosen), len(train) + HOLDOUT_ROWS)
    model = _scaled(config.untrained(key_init, dataset.obs_dim, dataset.act_dim), columns, len(train), normaliser)
    epoch = config.epoch_steps or max(LEAST_STEPS, -(-total // config.batch_size))
    fitted = fit(
        (model, jnp.asarray(config.decays(), jnp.float32)),
        _loss,
        columns,
        rows=len(train),
        bootstraps=bootstrap_rows(key_bootstrap, config.members, len(train), total),
        members=config.members,
        trainable=(_trainable(model), False),
        steps=config.epochs * epoch,
        stretch=epoch,
        batch_size=config.batch_size,
        learning_rate=config.learning_rate,
        stopping=EarlyStopping(_errors, len(train), last, config.patience, config.least_gain, _joined),
        noisy=False,
        key=key_train,
        progress=progress,
        what="dynamics model (transition ensemble)",
        remedy="lower dynamics.learning_rate or check the log for outliers with `odaf data info`",
    )
    errors = of_rows(_errors, fitted.model, columns, len(train), last).mean(axis=0)
    order = np.argsort(errors, kind="stable")
    best = jax.tree.map(lambda leaf: leaf[jnp.asarray(order)], fitted.model[0].network)
    model = eqx.tree_at(lambda tree: tree.network, fitted.model[0], best)
    return model, _report(model, errors[order], columns, len(train), last, fitted)


def _loss(model: Decayed, batch: Columns, key: PRNGKeyArray) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    del key
    return model[0].loss(*batch, weight_decay=model[1]), {}


def _errors(model: Decayed, batch: Columns) -> Float[Array, "rows members"]:
    """Mean squared error of the members' means, in the log's units, by which they are ranked."""
    states, actions, rewards, next_states = batch
    mean, _ = model[0].moments(states, actions)
    wanted = model[0].targets(states, rewards, next_states)
    return jnp.mean(jnp.square(mean - wanted[None]), axis=-1).T


def _joined(now: Any, kept: Any, better: Bool[Array, " members"]) -> Any:
    """Members that are better now as they are, the others as they were; what members share as it is now.

    Of what is trained in a `Decayed`: all else is None.
    """

    def chosen(new: Array, old: Array) -> Array:
        return jnp.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    network = jax.tree.map(chosen, now[0].network, kept[0].network)
    return eqx.tree_at(lambda tree: tree[0].network, now, network)


def _trainable(model: TransitionEnsemble) -> Any:
    mask = jax.tree.map(eqx.is_inexact_array, model)
    return eqx.tree_at(lambda m: (m.input_mean, m.input_std, m.centre, m.unit), mask, (False,) * 4)


def _scaled(model: TransitionEnsemble, columns: Columns, train: int, normaliser: Normaliser) -> TransitionEnsemble:
    """The model that knows the spread of its inputs in the rows to train on, and the user's units."""
    mean, std = _moments(columns[0], columns[1], jnp.asarray(train))
    unit = np.where(np.isfinite(normaliser.scale), normaliser.scale, np.float32(1.0))
    scaling = mean, std, jnp.asarray(normaliser.shift, jnp.float32), jnp.asarray(unit, jnp.float32)
    return eqx.tree_at(lambda m: (m.input_mean, m.input_std, m.centre, m.unit), model, scaling)


@jax.jit
def _moments(
    states: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"], count: Int[Array, ""]
) -> tuple[Float[Array, " inputs"], Float[Array, " inputs"]]:
    """Mean and standard deviation of the inputs in the first `count` rows, whose number is no shape of the program."""
    inputs = jnp.concatenate([states, actions], axis=-1)
    counted = (jnp.arange(inputs.shape[0]) < count)[:, None]
    number = count.astype(inputs.dtype)
    mean = jnp.sum(jnp.where(counted, inputs, 0.0), axis=0) / number
    apart = jnp.where(counted, jnp.square(inputs - mean[None]), 0.0)
    std = jnp.sqrt(jnp.sum(apart, axis=0) / number)
    return mean, jnp.where(std < SMALLEST_STD, 1.0, std)


def _measured(model: TransitionEnsemble, batch: Columns) -> Float[Array, "rows both outputs"]:
    """The elites' mean t, and the probability that they give together to a t below the one that came."""
    states, actions, rewards, next_states = batch
    mean, log_variance = (part[: model.elites] for part in model.moments(states, actions))
    wanted = model.targets(states, rewards, next_states)
    below = jnp.mean(jax.scipy.stats.norm.cdf((wanted[None] - mean) * jnp.exp(-0.5 * log_variance)), axis=0)
    return jnp.stack([jnp.mean(mean, axis=0), below], axis=1)


def _report(
    model: TransitionEnsemble,
    errors: Float[np.ndarray, " members"],
    columns: Columns,
    train: int,
    last: int,
    fitted: Fitted[Decayed],
) -> dict[str, Any]:
    states, _, rewards, next_states = (np.asarray(column)[train:last] for column in columns)
    found = of_rows(_measured, model, columns, train, last)
    change, below = found[:, 0, :-1] / np.asarray(model.unit), found[:, 1]
    by_dimension = np.mean(np.square(states + change - next_states), axis=0)
    unchanged = np.mean(np.square(states - next_states), axis=0)
    error, naive = float(by_dimension.mean()), float(unchanged.mean())
    report: dict[str, Any] = {
        "kind": "transition ensemble",
        "steps": fitted.steps,
        "training_loss": fitted.means["loss"],
        "holdout_rows": last - train,
        "holdout_mse": error,
        "holdout_mse_by_dimension": [float(v) for v in by_dimension],
        "no_change_mse": naive,
        "no_change_mse_by_dimension": [float(v) for v in unchanged],
        "error_ratio": error / naive if naive > 0 else float("inf"),
        "error_by_member": [float(v) for v in errors],
        "reward_mse": float(np.mean(np.square(found[:, 0, -1] - rewards))),
        "mean_reward_mse": float(np.mean(np.square(np.asarray(columns[2])[:train].mean() - rewards))),
    }
    for coverage in COVERAGES:
        inside = np.abs(below - 0.5) <= 0.5 * coverage
        report[f"coverage_{100 * coverage:.0f}"] = float(inside.mean())
        report[f"coverage_{100 * coverage:.0f}_by_dimension"] = [float(v) for v in inside.mean(axis=0)]
    report["warnings"] = list(_warnings(report))
    return report


def _warnings(report: dict[str, Any]) -> list[str]:
    found = []
    if not report["holdout_mse"] < report["no_change_mse"]:
        found.append(
            f"dynamics model: its hold-out error {report['holdout_mse']:.3g} is no better than predicting 'no change' "
            f"({report['no_change_mse']:.3g}), so rollouts of it teach what the system does not do; train it longer "
            "(dynamics.epochs, dynamics.patience)"
        )
    if report["coverage_90"] < LOW_COVERAGE:
        found.append(
            f"dynamics model: {100 * report['coverage_90']:.0f} % of the held-out targets lie inside its 90 % "
            "intervals, so it is surer than it is right, and penalties on its uncertainty are too small; log more "
            "episodes, or take fewer dynamics.epochs"
        )
    return found
