"""Networks in float64 NumPy, one member at a time. Only the numbers of the package's networks are read."""

import numpy as np


def numbers(array) -> np.ndarray:
    """A device array as float64."""
    return np.asarray(array, dtype=np.float64)


def mlp(network, rows, member: int | None = None) -> np.ndarray:
    """Linear layers; before an activation, where learnt, scale * (x - mean) / sqrt(var + 1e-5) + offset."""
    x = numbers(rows)
    pick = (lambda leaf: numbers(leaf)) if member is None else (lambda leaf: numbers(leaf)[member])
    layers = len(network.weights)
    for layer in range(layers):
        x = x @ pick(network.weights[layer]) + pick(network.biases[layer])
        if layer == layers - 1:
            break
        if len(network.scales):
            x = (x - x.mean(axis=-1, keepdims=True)) / np.sqrt(x.var(axis=-1, keepdims=True) + 1e-5)
            x = x * pick(network.scales[layer]) + pick(network.offsets[layer])
        x = np.maximum(x, 0.0) if network.activation == "relu" else x / (1.0 + np.exp(-x))
    return x


def q_values(critics, observations, actions) -> np.ndarray:
    """Q_k(s, a) as [critics, rows]."""
    inputs = np.concatenate([numbers(observations), numbers(actions)], axis=1)
    members = critics.networks.weights[0].shape[0]
    return np.stack([mlp(critics.networks, inputs, member)[:, 0] for member in range(members)])


def gaussian(actor, observations) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation before the tanh; the log standard deviation is cut to [-5, 2]."""
    output = mlp(actor.network, observations)
    half = output.shape[1] // 2
    return output[:, :half], np.exp(np.minimum(np.maximum(output[:, half:], -5.0), 2.0))


def act(actor, observations, noise) -> tuple[np.ndarray, np.ndarray]:
    """Sampled action and its log-density, by the density of the normal and the change of variables a = tanh(z)."""
    mean, std = gaussian(actor, observations)
    z = mean + std * numbers(noise)
    action = np.tanh(z)
    density = np.exp(-0.5 * ((z - mean) / std) ** 2) / (std * np.sqrt(2.0 * np.pi))
    return action, np.sum(np.log(density) - np.log(1.0 - action**2 + 1e-6), axis=1)


def mode(actor, observations) -> np.ndarray:
    """tanh(mean)."""
    return np.tanh(gaussian(actor, observations)[0])


def spread(values, ddof: int) -> np.ndarray:
    """Standard deviation over the first axis, with the 1e-12 that keeps its gradient finite."""
    return np.sqrt(np.var(numbers(values), axis=0, ddof=ddof) + 1e-12)
