"""OSR and CQL in float64 NumPy: the inverse-dynamics model, its loss, and the losses made of it, row by row."""

import numpy as np

from golden.networks import act, gaussian, mlp, numbers, q_values
from golden.smoothing import divergence


def _joined(*columns) -> np.ndarray:
    return np.concatenate([numbers(column) for column in columns], axis=1)


def _action(model, pair, latent) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation before the tanh: the first half of the decoder's outputs, and the second."""
    output = mlp(model.cvae.decoder, _joined(pair, latent))
    half = output.shape[1] // 2
    log_std = float(model.log_std_scale) * output[:, half:] + float(model.log_std_offset)
    return output[:, :half], np.exp(np.minimum(np.maximum(log_std, model.log_std_min), 2.0))


def inverse(model, observations, next_observations, noise) -> tuple[np.ndarray, np.ndarray]:
    """I(a | s, s'): z through the encoder, or from the prior cut to +-0.5 if the encoder needs the action."""
    pair = _joined(observations, next_observations)
    if model.cvae.sees_target:
        return _action(model, pair, np.minimum(np.maximum(numbers(noise), -0.5), 0.5))
    mean, log_std = np.split(mlp(model.cvae.encoder, pair), 2, axis=1)
    return _action(model, pair, mean + np.exp(log_std) * numbers(noise))


def inverse_loss(model, observations, actions, next_observations, latent_noise, action_noise) -> float:
    """Mean squared error of tanh of a drawn u, plus half the mean KL of q to the standard normal."""
    actions = np.minimum(np.maximum(numbers(actions), -0.999), 0.999)
    pair = _joined(observations, next_observations)
    mean, log_std = np.split(
        mlp(model.cvae.encoder, _joined(pair, actions) if model.cvae.sees_target else pair), 2, axis=1
    )
    action_mean, action_std = _action(model, pair, mean + np.exp(log_std) * numbers(latent_noise))
    error = np.tanh(action_mean + action_std * numbers(action_noise)) - actions
    kl = [divergence(m, np.exp(s), 0.0 * m, 1.0 + 0.0 * s) for m, s in zip(mean, log_std, strict=True)]
    return float(np.mean(error**2) + 0.5 * np.sum(kl) / mean.size)


def _kept(batch) -> list[int]:
    """Rows but those that end and repeat their state."""
    states, after = numbers(batch.observations), numbers(batch.next_observations)
    return [
        row for row in range(len(states)) if not (batch.terminated[row] and np.array_equal(states[row], after[row]))
    ]


def alignment(actor, model, batch, state_noise: float, normal, latent_noise) -> float:
    """Mean over rows and action dimensions of KL(pi(s^) || I(s^, s'))."""
    states = numbers(batch.observations) + state_noise * numbers(normal)
    mean, std = gaussian(actor, states)
    wanted, spread = inverse(model, states, batch.next_observations, latent_noise)
    rows = _kept(batch)
    return float(np.mean([divergence(mean[r], std[r], wanted[r], spread[r]) / mean.shape[1] for r in rows]))


def _soft_maximum(values, log_densities) -> float:
    return float(np.log(sum(np.exp(v - d) for v, d in zip(values, log_densities, strict=True))))


def values_gap(critics, actor, model, batch, state_noise: float, normal, latent_noise, back_noise, noise) -> float:
    """Mean over members and rows: soft maximum over policy actions less the value of the action that leads back."""
    states = numbers(batch.observations) + state_noise * numbers(normal)
    mean, std = inverse(model, states, batch.next_observations, latent_noise)
    back = q_values(critics, states, np.tanh(mean + std * numbers(back_noise)))
    draws = [act(actor, states, one) for one in noise]
    drawn = [q_values(critics, states, actions) for actions, _ in draws]
    gaps = [
        _soft_maximum([q[member, row] for q in drawn], [d[row] for _, d in draws]) - back[member, row]
        for member in range(len(back))
        for row in _kept(batch)
    ]
    return float(np.mean(gaps))


def conservative(critics, actor, batch, uniform, noise, next_noise) -> float:
    """Sum over members of the mean over rows of CQL(H)'s gap; every action is valued at the current state."""
    draws = [(numbers(u), np.full(len(u), np.log(0.5 ** u.shape[1]))) for u in uniform]
    draws += [act(actor, batch.observations, one) for one in noise]
    draws += [act(actor, batch.next_observations, one) for one in next_noise]
    drawn = [q_values(critics, batch.observations, actions) for actions, _ in draws]
    logged = q_values(critics, batch.observations, batch.actions)
    total = 0.0
    for member in range(len(logged)):
        for row in range(logged.shape[1]):
            soft = _soft_maximum([q[member, row] for q in drawn], [d[row] for _, d in draws])
            total += (soft - logged[member, row]) / logged.shape[1]
    return total
