"""Multi-layer perceptrons, single or stacked along a leading axis so that an ensemble is one batched product."""

import functools
import itertools
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.numbers import Number

Norm = Literal["none", "layer"]
Products = Literal["float32", "tensorfloat32", "bfloat16"]
Factors = tuple[Float[Array, "rows _width"], ...]  # of hidden units, one array a hidden layer
LAYER_NORM_EPSILON = 1e-5


class MLP(eqx.Module):
    """Linear layers with an activation between them, optionally layer-normalised before each activation.

    Weights are stored `(in, out)`. With a leading axis `(members, in, out)` the object is a stack of independent
    networks that one batched product evaluates together.
    """

    weights: tuple[Float[Array, "*stack _fan_in _fan_out"], ...]
    biases: tuple[Float[Array, "*stack _fan_out"], ...]
    scales: tuple[Float[Array, "*stack _fan_out"], ...]  # empty without layer normalisation
    offsets: tuple[Float[Array, "*stack _fan_out"], ...]
    activation: Literal["relu", "silu"] = eqx.field(static=True)
    products: Products = eqx.field(static=True, default="float32")  # what hidden layers round their factors to

    def __call__(self, x: Float[Array, "*any rows fan_in"], factors: Factors = ()) -> Float[Array, "*out rows fan_out"]:
        """Map rows through the network.

        Args:
            x: `(rows, in)`, or `(members, rows, in)` for a stack whose members see different rows.
            factors: of the hidden units after their activation, such as those of `dropout_factors`; () for none.

        Returns:
            `(rows, out)` for one network, `(members, rows, out)` for a stack; a stack given `(rows, in)` shows the
            same rows to every member.
        """
        return self._onwards(_product(x, self.weights[0], "float32") + _over_rows(self.biases[0]), factors)

    def of_draws(
        self, shared: Float[Array, "rows shared_in"], drawn: Float[Array, "draws rows drawn_in"]
    ) -> Float[Array, "draws rows fan_out"]:
        """Map rows whose first entries all draws share; the first layer's sums over these are computed once.

        For a single network, not a stack.

        Args:
            shared: first part of every input.
            drawn: the rest, one for each draw.

        Returns:
            What the network gives for the two side by side.
        """
        first, width = self.weights[0], shared.shape[1]
        sums = (shared @ first[:width] + _over_rows(self.biases[0]))[None] + drawn @ first[width:]
        return self._onwards(sums.reshape(-1, first.shape[1])).reshape(*drawn.shape[:2], -1)

    def _onwards(self, x: Float[Array, "*any rows width"], factors: Factors = ()) -> Float[Array, "*out rows fan_out"]:
        """From the first layer's sums to the output."""
        last = len(self.weights) - 1
        for index in range(last):
            if self.scales:
                x = _layer_norm(x) * _over_rows(self.scales[index]) + _over_rows(self.offsets[index])
            x = jax.nn.relu(x) if self.activation == "relu" else jax.nn.silu(x)
            if factors:
                x = x * factors[index]
            products = self.products if index + 1 < last else "float32"
            x = _product(x, self.weights[index + 1], products) + _over_rows(self.biases[index + 1])
        return x


def _product(
    x: Float[Array, "*a fan_in"], weight: Float[Array, "*b fan_out"], products: Products
) -> Float[Array, "*c fan_out"]:
    if products != "float32":
        return jnp.asarray(_rounded_product(x, weight, products))
    return x @ weight if weight.ndim == 2 else jnp.einsum(_equation(x, weight), x, weight)


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def _rounded_product(
    x: Float[Array, "*a fan_in"], weight: Float[Array, "*b fan_out"], products: Products
) -> Float[Array, "*c fan_out"]:
    """`_product` of rounded factors, summed in float32; the same in its backward pass.

    The rule is written out because the one that JAX derives multiplies numbers of unlike types, which processors'
    libraries do not. Reverse mode only.
    """
    return _mixed(_equation(x, weight), _round(x, products), _round(weight, products))


def _rounded_forward(x: Array, weight: Array, products: Products) -> tuple[Array, tuple[Array, Array]]:
    rounded = _round(x, products), _round(weight, products)
    return _mixed(_equation(x, weight), *rounded), rounded


def _rounded_backward(products: Products, factors: tuple[Array, Array], slope: Array) -> tuple[Array, Array]:
    x, weight = factors
    rows, columns, out = _equation(x, weight).replace("->", ",").split(",")
    slope = _round(slope, products)
    return (
        _mixed(f"{out},{columns}->{rows}", slope, weight),
        _mixed(f"{rows},{out}->{columns}", x, slope),
    )


_rounded_product.defvjp(_rounded_forward, _rounded_backward)


def _round(factor: Array, products: Products) -> Array:
    # Processors have no compiled products of 16-bit numbers for every shape, and may leave out a conversion there and
    # back, so they round in 32 bits. TF32 has float32's exponent and 10 bits of mantissa, bfloat16 has 7.
    if jax.default_backend() == "cpu":
        return jax.lax.reduce_precision(factor, 8, 7 if products == "bfloat16" else 10)
    if products == "bfloat16":
        return factor.astype(jnp.bfloat16)
    return factor if jax.default_backend() == "gpu" else jax.lax.reduce_precision(factor, 8, 10)


def _mixed(equation: str, a: Array, b: Array) -> Array:
    if a.dtype == jnp.bfloat16:
        return jnp.einsum(equation, a, b, preferred_element_type=jnp.float32)
    natively = jax.default_backend() == "gpu"  # whose products round to TF32 by themselves
    return jnp.einsum(equation, a, b, precision=jax.lax.Precision.HIGH if natively else jax.lax.Precision.HIGHEST)


def _equation(x: Array, weight: Array) -> str:
    if weight.ndim == 2:
        return "bi,io->bo"
    return "bi,kio->kbo" if x.ndim == 2 else "kbi,kio->kbo"


def _over_rows(parameter: Float[Array, "*stack width"]) -> Float[Array, "*stack 1 width"]:
    return parameter[..., None, :]


@jax.custom_jvp
def _layer_norm(x: Float[Array, "*rows width"]) -> Float[Array, "*rows width"]:
    """Rows shifted and scaled to mean 0 and variance 1.

    Its derivative is written out, and equals the one that JAX derives: dn = (d - mean(d) - n mean(n d)) / deviation.
    JAX's goes back through mean and variance one after the other and makes an update 5 to 10 % slower on a CPU.
    """
    return _normalised(x)[0]


@_layer_norm.defjvp
def _layer_norm_derivative(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    normalised, scale = _normalised(*primals)
    change = scale * tangents[0]
    return normalised, change - _row_mean(change) - normalised * _row_mean(normalised * change)


def _normalised(x: Float[Array, "*rows width"]) -> tuple[Float[Array, "*rows width"], Float[Array, "*rows 1"]]:
    centred = x - _row_mean(x)
    scale = jax.lax.rsqrt(_row_mean(jnp.square(centred)) + LAYER_NORM_EPSILON)
    return centred * scale, scale


def _row_mean(x: Float[Array, "*rows width"]) -> Float[Array, "*rows 1"]:
    # As a product with a constant vector: the CPU compiler vectorises those, not sums along the last axis.
    # Where products are rounded, this one is not.
    weights = jnp.full((x.shape[-1],), 1.0 / x.shape[-1], x.dtype)
    return jnp.matmul(x, weights, precision=jax.lax.Precision.HIGHEST)[..., None]


def init_mlp(
    key: PRNGKeyArray,
    sizes: tuple[int, ...],
    *,
    members: int | None = None,
    norm: Norm = "none",
    activation: Literal["relu", "silu"] = "relu",
    hidden_bias: float = 0.1,
    output_bound: float | None = None,
    products: Products = "float32",
    orthogonal_gain: float | None = None,
    output_gain: float | None = None,
) -> MLP:
    """Draw a network, or a stack of `members` independent ones.

    Args:
        key: random key.
        sizes: widths from input to output, at least two.
        members: number of stacked networks; None for a single one.
        norm: "layer" adds a learnt layer normalisation before every activation.
        activation: "relu" or "silu".
        hidden_bias: initial value of every hidden bias.
        output_bound: the last layer's weights and biases are uniform in plus or minus this; None treats the last layer
            like a hidden one with a zero bias.
        products: what the products between hidden layers round their factors to; sums are in float32 always.
        orthogonal_gain: every layer's weights are an orthogonal matrix times this; None draws them uniformly.
        output_gain: the same for the last layer alone; None takes `orthogonal_gain`.

    Source:
        Hidden weights uniform in +-1/sqrt(fan_in), biases 0.1 and a small uniform last layer: what the authors' codes
        of EDAC, RORL and ODAF use for their Q-ensembles.
    """
    stack = () if members is None else (members,)
    weights, biases = [], []
    for index, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
        key_weight, key_bias = jr.split(jr.fold_in(key, index))
        is_output = index == len(sizes) - 2
        bound = output_bound if is_output and output_bound is not None else fan_in**-0.5
        if orthogonal_gain is None:
            weights.append(jr.uniform(key_weight, (*stack, fan_in, fan_out), minval=-bound, maxval=bound))
        else:
            gain = output_gain if is_output and output_gain is not None else orthogonal_gain
            weights.append(_orthogonal(key_weight, members, (fan_in, fan_out), gain))
        if not is_output:
            biases.append(jnp.full((*stack, fan_out), hidden_bias, dtype=jnp.float32))
        elif output_bound is None:
            biases.append(jnp.zeros((*stack, fan_out)))
        else:
            biases.append(jr.uniform(key_bias, (*stack, fan_out), minval=-bound, maxval=bound))
    widths = sizes[1:-1] if norm == "layer" else ()
    return MLP(
        weights=tuple(weights),
        biases=tuple(biases),
        scales=tuple(jnp.ones((*stack, width)) for width in widths),
        offsets=tuple(jnp.zeros((*stack, width)) for width in widths),
        activation=activation,
        products=products,
    )


def dropout_factors(key: PRNGKeyArray, rate: Number, rows: int, widths: tuple[int, ...]) -> Factors:
    """0 for a share `rate` of hidden units, drawn for each row and layer, and 1 / (1 - rate) for the others.

    Source:
        Srivastava et al. 2014, scaled while training, so that nothing changes afterwards.
    """
    kept = (jr.bernoulli(jr.fold_in(key, layer), 1.0 - rate, (rows, width)) for layer, width in enumerate(widths))
    return tuple(jnp.where(unit, 1.0 / (1.0 - rate), 0.0) for unit in kept)


def _orthogonal(
    key: PRNGKeyArray, members: int | None, shape: tuple[int, int], gain: float
) -> Float[Array, "*stack fan_in fan_out"]:
    draw = jax.nn.initializers.orthogonal(gain)
    if members is None:
        return draw(key, shape, jnp.float32)
    return jax.vmap(lambda key: draw(key, shape, jnp.float32))(jr.split(key, members))
