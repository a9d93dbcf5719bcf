"""The released code of ODAF in float64 NumPy: RORL's losses, and a mean over perturbed states of the critics' spread.

Written from the description of that code. Every draw is given by the caller.
"""

import numpy as np

from golden import pessimism, smoothing, soft_actor_critic
from golden.networks import act, numbers, q_values


def actor_loss(actor, state, batch, predict, draws, *, policy_weight: float, outcome_weight: float) -> float:
    """mean(alpha log pi - min_k Q_k) + beta_P mean_B max_i J_i + 0.1 mean over draws and rows of std_k Q_k(s^', a^').

    Args:
        actor: the policy that is differentiated.
        state: everything else, held fast; the policy that acts at s^ a second time among it.
        batch: logged rows.
        predict: (s, a, noise) -> s'.
        draws: "noise" of a~; "policy" offsets [draws, rows, obs_dim]; "outcome" offsets, with "outcome_noise" for each
            draw: of a^, of the model, of a^'.
        policy_weight: beta_P.
        outcome_weight: of the last term.
    """
    loss = soft_actor_critic.actor_loss(actor, state.online_critics, state.log_temperature.now, batch, draws["noise"])
    loss += policy_weight * smoothing.worst(smoothing.policy_changes(actor, batch.observations, draws["policy"]))
    spreads = []
    for offset, noise in zip(draws["outcome"], draws["outcome_noise"], strict=True):
        perturbed = numbers(batch.observations) + numbers(offset)
        action, _ = act(actor, perturbed, noise[0])
        outcome = predict(perturbed, action, noise[1])
        then, _ = act(state.actor.now, perturbed, noise[2])  # at s^, not at the outcome; a constant
        values = q_values(state.online_critics, outcome, then)
        mean = values.mean(axis=0)
        spreads.append(np.sqrt(((values - mean) ** 2).sum(axis=0) / (len(values) - 1) + 1e-12))
    return loss + outcome_weight * float(np.mean(spreads))


def critic_loss(critics, state, batch, draws, *, value_weight, fall_weight, ood_weight, deviations, discount) -> float:
    """sum_k mean_B (Q_k - y)^2 + beta_Q mean_B max_i l_i + w mean over members, rows and draws of (Q_k - t_k)^2.

    Args:
        critics: the critics that are differentiated.
        state: everything else, held fast; the critics that the targets t_k come from among it.
        batch: logged rows.
        draws: "noise" of a'; "value" offsets; "ood" offsets and "ood_noise", draw by draw.
        value_weight: beta_Q.
        fall_weight: tau.
        ood_weight: w.
        deviations: lambda.
        discount: gamma.
    """
    y = soft_actor_critic.target(state, batch, draws["noise"], discount, entropy_in_backup=True)
    loss = soft_actor_critic.critic_loss(critics, batch, y)
    changes = smoothing.value_changes(critics, batch.observations, batch.actions, draws["value"], fall_weight)
    loss += value_weight * smoothing.worst(changes)
    return loss + ood_weight * pessimism.pull_down(
        critics,
        state.actor.now,
        pessimism.repeated(batch.observations, draws["ood"]),
        draws["ood_noise"],
        deviations,
        ddof=1,
        fixed_critics=state.online_critics,
    )
