"""How probable logged actions are under whoever acted, and how much the policy's actions are like them."""

from dataclasses import dataclass

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.behaviour_models import gaussian_loss, init_gaussian, log_density_inside
from odaf.components.fitting import Batch, EarlyStopping, Progress, fit, of_rows
from odaf.components.policies import NarrowGaussianActor

STRETCH = 1_000
HOLDOUT = 0.1  # of the episodes, for early stopping
RARE = 0.01  # of logged actions are less probable than the bound below which an action is unlike the log's


@dataclass(frozen=True, eq=False)
class BehaviourDensity:
    """A squashed Gaussian fitted to the log, early stopping by its likelihood on episodes held out."""

    model: NarrowGaussianActor
    observations: Array

    def log_density(self, actions: np.ndarray) -> np.ndarray:
        """log b(a|s) in nats of an action in [-1, 1] for every row; it is cut to +-0.999."""
        return of_rows(_log_density, self.model, (self.observations, jnp.asarray(actions))).astype(np.float64)

    def share_unlike(self, logged: np.ndarray, actions: np.ndarray) -> float:
        """Share of actions less probable than all but a hundredth of the logged ones."""
        bound = np.quantile(self.log_density(logged), RARE)
        return float(np.mean(self.log_density(actions) < bound))


def fit_density(
    observations: np.ndarray,
    actions: np.ndarray,
    episodes: np.ndarray,
    key: PRNGKeyArray,
    *,
    hidden_sizes: tuple[int, ...],
    steps: int,
    batch_size: int,
    learning_rate: float,
    patience: int,
    progress: Progress,
) -> BehaviourDensity:
    """Fit the Gaussian to rows in normalised units, `episodes` the number of each row's; the rest as for `fit_q`.

    Raises:
        DivergenceError: the loss stopped being finite.
    """
    key_order, key_init, key_fit = jr.split(key, 3)
    there = np.unique(episodes)
    order = there[np.asarray(jr.permutation(key_order, len(there)))]
    aside = order[: min(max(round(HOLDOUT * len(there)), 1), len(there) - 1)]
    held_out = np.isin(episodes, aside)
    rows = np.concatenate([np.flatnonzero(~held_out), np.flatnonzero(held_out)])
    first = int(np.sum(~held_out))
    states, taken = jnp.asarray(observations[rows]), jnp.asarray(actions[rows])
    fitted = fit(
        (init_gaussian(key_init, observations.shape[1], actions.shape[1], hidden_sizes), jnp.ones(())),
        gaussian_loss,
        (states, taken, states),
        rows=first,
        steps=steps,
        batch_size=batch_size,
        learning_rate=learning_rate,
        stretch=min(steps, STRETCH),
        stopping=EarlyStopping(_misfit, first, len(rows), patience),
        key=key_fit,
        progress=progress,
        what="behaviour density",
        remedy="lower learning_rate, or check the log for outliers with `odaf data check`",
    )
    return BehaviourDensity(fitted.model[0], jnp.asarray(observations))


def _misfit(model: tuple[NarrowGaussianActor, Float[Array, ""]], batch: Batch) -> Float[Array, " rows"]:
    return -log_density_inside(model[0], batch[0], batch[1])


def _log_density(model: NarrowGaussianActor, batch: Batch) -> Float[Array, " rows"]:
    return log_density_inside(model, batch[0], batch[1])
