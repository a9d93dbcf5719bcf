"""What both sides train with, imported by either interpreter: no more than plain Python in here.

Settings are ours by name; `peer.py` and `ours.py` translate them. Where a learner has a published setting of its own it
stands here, otherwise those that both have in common.
"""

from typing import Any

# Cheap ones first: runs go through them in this order.
LEARNERS: dict[str, dict[str, Any]] = {
    "behaviour-cloning": {"hidden_sizes": (256, 256), "learning_rate": 3e-4, "batch_size": 256},
    "td3-bc": {
        "hidden_sizes": (256, 256),
        "value_weight": 2.5,
        "discount": 0.99,
        "target_noise": 0.2,
        "noise_clip": 0.5,
        "actor_delay": 2,
        "target_rate": 5e-3,
        "learning_rate": 3e-4,
        "batch_size": 256,
    },
    "iql": {
        "hidden_sizes": (256, 256),
        "expectile": 0.7,
        "inverse_temperature": 3.0,
        "weight_cap": 100.0,
        "discount": 0.99,
        "reward_scale": "returns",
        "target_rate": 5e-3,
        "learning_rate": 3e-4,
        "actor_decay_updates": 0,
        "batch_size": 256,
    },
    "rebrac": {
        "hidden_sizes": (256, 256, 256),
        "actor_penalty": 0.01,
        "critic_penalty": 0.01,
        "discount": 0.99,
        "target_noise": 0.2,
        "noise_clip": 0.5,
        "actor_delay": 2,
        "target_rate": 5e-3,
        "actor_learning_rate": 1e-3,
        "critic_learning_rate": 1e-3,
        "batch_size": 256,
    },
    "bcq": {
        "hidden_sizes": (400, 300),
        "behaviour_hidden_sizes": (750, 750),
        "perturbation": 0.05,
        "num_actions": 10,
        "lowest_weight": 0.75,
        "discount": 0.99,
        "target_rate": 5e-3,
        "learning_rate": 1e-3,
        "batch_size": 100,
    },
    "bear": {
        "hidden_sizes": (256, 256),
        "behaviour_hidden_sizes": (750, 750),
        "kernel": "gaussian",
        "kernel_width": 20.0,
        "threshold": 0.05,
        "num_draws": 4,
        "num_actions": 10,
        "lowest_weight": 0.75,
        "warm_up_steps": 4_000,
        "discount": 0.99,
        "target_rate": 5e-3,
        "actor_learning_rate": 1e-4,
        "critic_learning_rate": 3e-4,
        "behaviour_learning_rate": 3e-4,
        "weight_learning_rate": 1e-3,
        "batch_size": 256,
    },
    "cql": {
        "actor_hidden_sizes": (256, 256),
        "critic_hidden_sizes": (256, 256),
        "conservative_weight": 5.0,
        "num_actions": 10,
        "lagrange_gap": None,
        "discount": 0.99,
        "target_rate": 5e-3,
        "actor_learning_rate": 1e-4,
        "critic_learning_rate": 3e-4,
        "temperature_learning_rate": 1e-4,
        "batch_size": 256,
    },
}

# What is otherwise when losses are compared: few draws, and every part of a learner at work.
FOR_LOSSES: dict[str, dict[str, Any]] = {
    "bcq": {"num_actions": 4},
    "bear": {"num_actions": 4, "num_draws": 3, "warm_up_steps": 0},
    "cql": {"num_actions": 3, "lagrange_gap": 1.0},
}

NORMALISER_EPSILON = 1e-3  # added to the observations' spreads by both sides

# Small shapes, in which a formula shows itself as well as in large ones, for comparing losses.
OBS_DIM, ACT_DIM, ROWS, HIDDEN = 5, 2, 32, 16

# So small that weights stay the copied ones within an update, whatever the order of its steps.
STANDSTILL = 1e-30


def for_losses(name: str) -> dict[str, Any]:
    """Settings of a learner whose losses are compared."""
    settings = LEARNERS[name] | FOR_LOSSES.get(name, {})
    sizes = {key: (HIDDEN,) * len(value) for key, value in settings.items() if key.endswith("hidden_sizes")}
    rates = {key: STANDSTILL for key in settings if key.endswith("learning_rate")}
    return settings | sizes | rates | {"batch_size": ROWS}
