"""d3rlpy's weights as networks of ours: its linear layers hold (out, in), ours (in, out)."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from odaf.components.networks import MLP

Arrays = Mapping[str, np.ndarray]


def network(arrays: Arrays, module: str, heads: Sequence[str] = ("_fc",)) -> MLP:
    """One network: the layers of a module's encoder, then its heads side by side as the last layer.

    Layers of the encoder are told apart by their numbers; those with one-dimensional weights normalise, and have to
    come right after a linear one.
    """
    numbers = sorted({int(key.split(".")[-2]) for key in arrays if key.startswith(f"{module}._encoder._layers.")})
    layers = {number: arrays[f"{module}._encoder._layers.{number}.weight"] for number in numbers}
    biases = {number: arrays[f"{module}._encoder._layers.{number}.bias"] for number in numbers}
    linear = [number for number, weight in layers.items() if weight.ndim == 2]
    norms = [number for number in layers if number not in linear]
    if norms and norms != [number + 1 for number in linear]:
        raise ValueError(f"{module}: not normalised before each activation, as a network of ours would be")
    weights = [layers[number].T for number in linear]
    weights.append(np.concatenate([arrays[f"{module}.{head}.weight"].T for head in heads], axis=1))
    last = np.concatenate([arrays[f"{module}.{head}.bias"] for head in heads])
    return MLP(
        weights=tuple(map(jnp.asarray, weights)),
        biases=tuple(jnp.asarray(bias) for bias in [*(biases[number] for number in linear), last]),
        scales=tuple(jnp.asarray(layers[number]) for number in norms),
        offsets=tuple(jnp.asarray(biases[number]) for number in norms),
        activation="relu",
    )


def stack(arrays: Arrays, module: str) -> MLP:
    """The members of an ensemble as one stack."""
    members = sorted({key.split(".")[1] for key in arrays if key.startswith(f"{module}.")}, key=int)
    networks = [network(arrays, f"{module}.{member}") for member in members]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *networks)


def part(arrays: Arrays, prefix: str) -> dict[str, np.ndarray]:
    """The arrays under `PREFIX/`, by the rest of their names."""
    return {key.removeprefix(f"{prefix}/"): value for key, value in arrays.items() if key.startswith(f"{prefix}/")}
