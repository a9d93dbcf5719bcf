"""Randomised prior functions: a fixed random network added to each critic (Osband et al. 2018)."""

import equinox as eqx
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.networks import MLP, Products, init_mlp
from odaf.components.targets import frozen


class Priors(eqx.Module):
    """A stack of networks that are never trained, or, inside `over_members`, one of them."""

    networks: MLP
    scale: float = eqx.field(static=True)

    def value(self, inputs: Float[Array, "rows in_dim"]) -> Float[Array, " rows"]:
        """What one member's prior adds for rows of states and actions side by side; its parameters get no gradient."""
        return self.scale * frozen(self.networks)(inputs)[:, 0]

    def values_of_many(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "draws rows act_dim"]
    ) -> Float[Array, "draws rows"]:
        """The same for several actions a state."""
        return self.scale * frozen(self.networks).of_draws(observations, actions)[..., 0]


def init_priors(
    key: PRNGKeyArray,
    obs_dim: int,
    act_dim: int,
    hidden_sizes: tuple[int, ...],
    num_critics: int,
    scale: float,
    products: Products = "float32",
) -> Priors | None:
    """Draw a prior for each critic, its last layer drawn like a hidden one; None for a scale of 0.

    Args:
        key: the key that the critics are drawn with.
        obs_dim: state dimension.
        act_dim: action dimension.
        hidden_sizes: widths of the hidden layers, as in the critics.
        num_critics: K.
        scale: factor of what is added.
        products: what the products between hidden layers round their factors to.
    """
    if scale == 0.0:
        return None
    sizes = (obs_dim + act_dim, *hidden_sizes, 1)
    return Priors(init_mlp(jr.fold_in(key, len(sizes)), sizes, members=num_critics, products=products), scale)
