"""The stacked ensemble of Q-functions and what is read off it."""

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.networks import MLP, Norm, init_mlp

ROOT_EPSILON = 1e-12

Result = TypeVar("Result", bound=PyTree)


def over_members(function: Callable[[MLP], Result], networks: MLP) -> Result:
    """Apply a function of one network to every network of a stack; results are stacked along a new first axis.

    On a CPU one member is done after another, so that its activations stay in the cache: 1.4 to 1.5 times as fast as
    one batched product at 256 rows and 256 units. Elsewhere all members are one batched product.
    """
    if jax.default_backend() == "cpu":
        return jax.lax.map(function, networks)
    return jax.vmap(function)(networks)


class CriticEnsemble(eqx.Module):
    """Q_1..Q_K as one stack of networks."""

    networks: MLP

    def __call__(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "critics rows"]:
        """Q_k(s, a) of every member for every row."""
        inputs = jnp.concatenate([observations, actions], axis=-1)
        return over_members(lambda network: network(inputs)[:, 0], self.networks)

    def as_constants(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "critics rows"]:
        """The same values as a function of states and actions only: no gradient is formed for the parameters.

        Reverse mode only. What an actor's loss should use: it takes each member's slope in its inputs together with its
        value, which is 1.6 times as fast on a CPU as a backward pass after all forward passes.
        """
        return _values_of_constants(self.networks, jnp.concatenate([observations, actions], axis=-1))


@jax.custom_vjp
def _values_of_constants(networks: MLP, inputs: Float[Array, "rows in_dim"]) -> Float[Array, "critics rows"]:
    return over_members(lambda network: network(inputs)[:, 0], networks)


def _values_and_slopes(networks: MLP, inputs: Float[Array, "rows in_dim"]) -> tuple[Array, tuple[Array, MLP]]:
    def member(network: MLP) -> tuple[Float[Array, " rows"], Float[Array, "rows in_dim"]]:
        values, pull_back = jax.vjp(lambda rows: network(rows)[:, 0], inputs)
        return values, pull_back(jnp.ones_like(values))[0]  # rows do not interact: dQ_k/d(input) of every row

    values, slopes = over_members(member, networks)
    return values, (slopes, networks)


def _pull_back(residuals: tuple[Array, MLP], cotangents: Float[Array, "critics rows"]) -> tuple[MLP, Array]:
    slopes, networks = residuals
    return jax.tree.map(jnp.zeros_like, networks), jnp.einsum("kr,kri->ri", cotangents, slopes)


_values_of_constants.defvjp(_values_and_slopes, _pull_back)


def init_critics(
    key: PRNGKeyArray,
    obs_dim: int,
    act_dim: int,
    hidden_sizes: tuple[int, ...],
    num_critics: int,
    norm: Norm,
    output_bound: float,
) -> CriticEnsemble:
    """Draw `num_critics` independent Q-functions; the last layer is uniform in plus or minus `output_bound`."""
    sizes = (obs_dim + act_dim, *hidden_sizes, 1)
    return CriticEnsemble(init_mlp(key, sizes, members=num_critics, norm=norm, output_bound=output_bound))


def disagreement(values: Float[Array, "critics *rows"], ddof: int = 0) -> Float[Array, "*rows"]:
    """Standard deviation over the ensemble: the uncertainty U(s, a).

    Args:
        values: Q_k(s, a).
        ddof: 0 divides by K, as the ODAF paper writes it; 1 divides by K - 1, as its released code does.

    Returns:
        One non-negative number a row. 1e-12 inside the root keeps the gradient finite where all members agree.
    """
    centred = values - jnp.mean(values, axis=0, keepdims=True)
    variance = jnp.sum(jnp.square(centred), axis=0) / (values.shape[0] - ddof)
    return jnp.sqrt(variance + ROOT_EPSILON)
