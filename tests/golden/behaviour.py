"""The loss of the behaviour auto-encoder in float64 NumPy, row by row."""

import numpy as np

from golden import networks


def misfit(model, states, actions, noise) -> np.ndarray:
    """l(s, a): both parts are means, over action dimensions and over latent ones."""
    states, actions, noise = map(networks.numbers, (states, actions, noise))
    output = networks.mlp(model.cvae.encoder, np.concatenate([states, actions], axis=1))
    latents = output.shape[1] // 2
    mean, std = output[:, :latents], np.exp(np.minimum(np.maximum(output[:, latents:], -4.0), 15.0))
    decoded = np.tanh(networks.mlp(model.cvae.decoder, np.concatenate([states, mean + std * noise], axis=1)))
    divergence = -0.5 * (1.0 + np.log(std**2) - mean**2 - std**2)
    rows = []
    for row in range(len(states)):
        residual = sum((decoded[row] - actions[row]) ** 2) / actions.shape[1]
        rows.append(residual + 0.5 * sum(divergence[row]) / latents)
    return np.array(rows)
