"""Which action leads from a state to a next state: a plain regression, for actions whose outcome is a logged state."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.fitting import Progress, fit, of_rows
from odaf.components.networks import MLP, init_mlp
from odaf.components.pretraining import Rows, split_columns
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser


class InverseMap(eqx.Module):
    """a = tanh( MLP(s, (s' - s) / scale) ), in normalised units; a plain regression."""

    network: MLP
    scale: Float[Array, " obs_dim"]

    def __call__(
        self, observations: Float[Array, "rows obs_dim"], next_observations: Float[Array, "rows obs_dim"]
    ) -> Float[Array, "rows act_dim"]:
        """Actions in [-1, 1]."""
        change = (next_observations - observations) / self.scale[None, :]
        return jnp.tanh(self.network(jnp.concatenate([observations, change], axis=-1)))


def fit_inverse_map(
    dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, steps: int, hidden: tuple[int, ...], progress: Progress
) -> tuple[InverseMap, float]:
    """Fits the map by least squares; returns it with R^2 on held-out episodes, all action dimensions together."""
    key_split, key_init, key_train = jr.split(key, 3)
    rows = split_columns(dataset, normaliser, 0.05, key_split, "inverse map", "give a larger log")
    states, _, next_states = rows.training()
    scale = np.maximum(np.std(next_states - states, axis=0), 1e-6)
    widths = (2 * dataset.obs_dim, *hidden, dataset.act_dim)
    model = InverseMap(init_mlp(key_init, widths), jnp.asarray(scale, jnp.float32))
    fitted = fit(
        model,
        _inverse_loss,
        rows.columns,
        rows=rows.train,
        steps=steps,
        batch_size=256,
        learning_rate=1e-3,
        schedule="cosine",
        noisy=False,
        trainable=eqx.tree_at(lambda tree: tree.scale, jax.tree.map(eqx.is_inexact_array, model), False),
        key=key_train,
        progress=progress,
        what="inverse map",
        remedy="check the log for outliers with `odaf data info`",
    )
    errors = of_rows(_inverse_errors, fitted.model, rows.columns, rows.train, rows.last_measured)
    return fitted.model, float(1.0 - errors.mean() / rows.measured()[1].var(axis=0).mean())


def _inverse_errors(model: InverseMap, batch: Rows) -> Float[Array, " rows"]:
    return jnp.mean(jnp.square(model(batch[0], batch[2]) - batch[1]), axis=-1)


def _inverse_loss(
    model: InverseMap, batch: Rows, key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    del key
    return jnp.mean(_inverse_errors(model, batch)), {}
