"""An ensemble of transitions in float64 NumPy, one member and one row at a time."""

import numpy as np

from golden.networks import mlp, numbers


def moments(model, observations, actions, member: int) -> tuple[np.ndarray, np.ndarray]:
    """Means and variances of (s' - s, r), the log-variance softly held between two bounds."""
    rows = np.concatenate([numbers(observations), numbers(actions)], axis=1)
    rows = (rows - numbers(model.input_mean)) / numbers(model.input_std)
    mean, log_variance = np.split(mlp(model.network, rows, member), 2, axis=1)
    high, low = numbers(model.log_variance_max), numbers(model.log_variance_min)
    log_variance = high - np.log1p(np.exp(high - log_variance))
    log_variance = low + np.log1p(np.exp(log_variance - low))
    return mean, np.exp(log_variance)


def loss(model, observations, actions, rewards, next_observations, decay) -> float:
    """The members' Gaussian losses, half the squared weights of each layer by its decay, and the bounds."""
    total = 0.01 * float(np.sum(numbers(model.log_variance_max)) - np.sum(numbers(model.log_variance_min)))
    for layer, weights in enumerate(model.network.weights):
        total += 0.5 * float(decay[layer]) * float(np.sum(numbers(weights) ** 2))
    for member in range(len(observations)):
        mean, variance = moments(model, observations[member], actions[member], member)
        change = numbers(model.unit) * (numbers(next_observations[member]) - numbers(observations[member]))
        wanted = np.concatenate([change, numbers(rewards[member])[:, None]], axis=1)
        total += float(np.mean((mean - wanted) ** 2 / variance)) + float(np.mean(np.log(variance)))
    return total


def uncertainty(model, observations, actions, kind: str) -> np.ndarray:
    """u(s, a), row by row."""
    members = range(model.network.weights[0].shape[0])
    said = [moments(model, observations, actions, member) for member in members]
    means, variances = (np.stack(part) for part in zip(*said, strict=True))
    found = []
    for row in range(means.shape[1]):
        if kind == "deviation":
            found.append(max(np.sqrt(variances[member, row].sum()) for member in members))
            continue
        states = means[:, row, :-1]
        centre = states.mean(axis=0)
        if kind == "disagreement":
            found.append(max(np.linalg.norm(state - centre) for state in states))
        else:
            found.append(np.sqrt(np.mean([np.var(states[:, dim]) for dim in range(states.shape[1])])))
    return np.asarray(found)
