"""The stacked ensemble of Q-functions and what is read off it."""

import os
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.networks import MLP, Norm, Products, init_mlp
from odaf.components.priors import Priors

ROOT_EPSILON = 1e-12
OUTPUT_BOUND = 3e-3  # small first weights of a last layer lie in plus or minus this
UNROLLED = 10  # members that are compiled side by side on several cores

Member = TypeVar("Member", bound=PyTree)
Result = TypeVar("Result", bound=PyTree)


def over_members(function: Callable[[Member], Result], stack: Member) -> Result:
    """Apply a function of one member to every member of a stack; results are stacked along a new first axis.

    How is a matter of speed alone. On an accelerator all members are one batched product. On one processor core, one
    member is done after another, so that its activations stay in the cache. On several cores members are written out
    side by side, up to `UNROLLED` at a time: each core can take a member of its own with all that goes with it, and the
    compiler finds what the parts of an update have in common, which it does not across loops.
    """
    if jax.default_backend() != "cpu":
        return jax.vmap(function)(stack)
    if usable_cores() == 1:
        return jax.lax.map(function, stack)
    members = jax.tree.leaves(stack)[0].shape[0]
    group = max(size for size in range(1, UNROLLED + 1) if members % size == 0)
    if group == members:
        return _written_out(function, stack)
    groups = jax.tree.map(lambda leaf: leaf.reshape(members // group, group, *leaf.shape[1:]), stack)
    results = jax.lax.map(lambda part: _written_out(function, part), groups)
    return jax.tree.map(lambda leaf: leaf.reshape(members, *leaf.shape[2:]), results)


def usable_cores() -> int:
    """Processor cores that computations here are laid out for.

    XLA takes as many threads as the environment variable NPROC says where it is set before JAX starts, and otherwise as
    many as there are cores for this process. What a sum over a batch adds up to in the last bit follows from that.
    """
    told = os.environ.get("NPROC", "")
    if told.isdecimal() and int(told) > 0:
        return int(told)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _written_out(function: Callable[[Member], Result], stack: Member) -> Result:
    members = jax.tree.leaves(stack)[0].shape[0]
    traced_once = jax.jit(function)  # the compiler puts the calls back in line
    results = [traced_once(jax.tree.map(lambda leaf, k=k: leaf[k], stack)) for k in range(members)]
    return jax.tree.map(lambda *parts: jnp.stack(parts), *results)


class CriticEnsemble(eqx.Module):
    """Q_1..Q_K as one stack of networks, each with a fixed random network added to it if there are priors.

    Inside `over_members` the same class stands for a single member.
    """

    networks: MLP
    priors: Priors | None = None

    def __call__(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "critics rows"]:
        """Q_k(s, a) of every member for every row."""
        inputs = jnp.concatenate([observations, actions], axis=-1)
        return over_members(lambda member: member.value(inputs), self)

    def value(self, inputs: Float[Array, "rows in_dim"]) -> Float[Array, " rows"]:
        """Q_k of a single member for rows of states and actions side by side; its prior gets no gradient."""
        values = self.networks(inputs)[:, 0]
        return values if self.priors is None else values + self.priors.value(inputs)

    def values_of_many(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "draws rows act_dim"]
    ) -> Float[Array, "draws rows"]:
        """Q_k of a single member for several actions a state; its prior gets no gradient."""
        values = self.networks.of_draws(observations, actions)[..., 0]
        return values if self.priors is None else values + self.priors.values_of_many(observations, actions)

    def first(self) -> "CriticEnsemble":
        """Q_1 alone."""
        return jax.tree.map(lambda leaf: leaf[:1], self)

    def as_constants(
        self, observations: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "critics rows"]:
        """The same values as a function of states and actions only: no gradient is formed for the parameters.

        Reverse mode only. What an actor's loss should use: it takes each member's slope in its inputs together with its
        value, which is 1.6 times as fast on a CPU as a backward pass after all forward passes.
        """
        return _values_of_constants(self, jnp.concatenate([observations, actions], axis=-1))


@jax.custom_vjp
def _values_of_constants(critics: CriticEnsemble, inputs: Float[Array, "rows in_dim"]) -> Float[Array, "critics rows"]:
    return over_members(lambda member: member.value(inputs), critics)


def _values_and_slopes(
    critics: CriticEnsemble, inputs: Float[Array, "rows in_dim"]
) -> tuple[Array, tuple[Array, CriticEnsemble]]:
    def member(critic: CriticEnsemble) -> tuple[Float[Array, " rows"], Float[Array, "rows in_dim"]]:
        values, pull_back = jax.vjp(critic.value, inputs)
        return values, pull_back(jnp.ones_like(values))[0]  # rows do not interact: dQ_k/d(input) of every row

    values, slopes = over_members(member, critics)
    return values, (slopes, critics)


def _pull_back(
    residuals: tuple[Array, CriticEnsemble], cotangents: Float[Array, "critics rows"]
) -> tuple[CriticEnsemble, Array]:
    slopes, critics = residuals
    return jax.tree.map(jnp.zeros_like, critics), jnp.einsum("kr,kri->ri", cotangents, slopes)


_values_of_constants.defvjp(_values_and_slopes, _pull_back)


def init_critics(
    key: PRNGKeyArray,
    obs_dim: int,
    act_dim: int,
    hidden_sizes: tuple[int, ...],
    num_critics: int,
    norm: Norm,
    output_bound: float | None,
    products: Products = "float32",
    hidden_bias: float = 0.1,
) -> MLP:
    """Draw the networks of `num_critics` independent Q-functions as one stack.

    Args:
        key: random key.
        obs_dim: state dimension.
        act_dim: action dimension.
        hidden_sizes: widths of the hidden layers.
        num_critics: K.
        norm: whether hidden layers are normalised.
        output_bound: the last layer is uniform in plus or minus this; None draws it like a hidden one.
        products: what the products between hidden layers round their factors to.
        hidden_bias: initial value of every hidden bias.
    """
    return init_mlp(
        key,
        (obs_dim + act_dim, *hidden_sizes, 1),
        members=num_critics,
        norm=norm,
        hidden_bias=hidden_bias,
        output_bound=output_bound,
        products=products,
    )


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
