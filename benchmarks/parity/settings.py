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
}

NORMALISER_EPSILON = 1e-3  # added to the observations' spreads by both sides

# Small shapes, in which a formula shows itself as well as in large ones, for comparing losses.
OBS_DIM, ACT_DIM, ROWS, HIDDEN = 5, 2, 32, 16

# So small that weights stay the copied ones within an update, whatever the order of its steps.
STANDSTILL = 1e-30
