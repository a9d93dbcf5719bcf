"""EDAC's diversity in float64 NumPy: slopes by the chain rule written out layer by layer, then pair by pair."""

import numpy as np

from golden.networks import numbers


def action_slope(network, row, act_dim: int, member: int) -> np.ndarray:
    """dQ_k/da of one member at one row (s, a): Jacobians of the layers, multiplied from the input to the output."""
    x = numbers(row)
    jacobian = np.eye(len(x))[:, len(x) - act_dim :]  # of the input in the action
    layers = len(network.weights)
    for layer in range(layers):
        weight = numbers(network.weights[layer])[member]
        x, jacobian = x @ weight + numbers(network.biases[layer])[member], weight.T @ jacobian
        if layer == layers - 1:
            break
        if len(network.scales):
            scale, n = numbers(network.scales[layer])[member], len(x)
            std = np.sqrt(x.var() + 1e-5)
            standard = (x - x.mean()) / std
            # d standard_i / d x_j = (delta_ij - 1/n - standard_i standard_j / n) / std
            through = (np.eye(n) - 1.0 / n - np.outer(standard, standard) / n) / std
            x = standard * scale + numbers(network.offsets[layer])[member]
            jacobian = scale[:, None] * (through @ jacobian)
        x, jacobian = np.maximum(x, 0.0), (x > 0.0)[:, None] * jacobian
    return jacobian[0]


def diversity(critics, observations, actions) -> float:
    """Mean over rows of the sum over ordered pairs of different members of <ghat_i, ghat_j>, over K - 1."""
    actions = numbers(actions)
    members = critics.networks.weights[0].shape[0]
    total = 0.0
    for state, action in zip(numbers(observations), actions, strict=True):
        row = np.concatenate([state, action])
        directions = []
        for member in range(members):
            slope = action_slope(critics.networks, row, len(action), member)
            directions.append(slope / (np.sqrt(np.sum(slope**2)) + 1e-10))
        pairs = sum(float(directions[i] @ directions[j]) for i in range(members) for j in range(members) if i != j)
        total += pairs / (members - 1)
    return total / len(actions)
