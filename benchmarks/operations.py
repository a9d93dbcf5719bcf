"""Floating-point operations of one update, counted by hand.

Counted is what the losses need, not what our code happens to do; a product of an (m, n) and an (n, p) matrix is 2 m n p
operations, and nothing but products is counted (no activations, norms, random numbers, optimiser). So the share of the
ceiling that is derived from these counts is a lower bound of how busy the products are.

Passes over a network, in units of one forward pass of one row (F = 2 * sum of products of neighbouring widths; F1 the
part of the first layer):

    forward                                   F
    back to the inputs                        F
    back to the parameters                    2 F - F1    (weights F, through the hidden layers F - F1)

With C the critics' pass (all K members), A the actor's, D the dynamics model's, B rows a batch:

| part | rows | passes |
|---|---|---|
| target: a' ~ pi(s'), all target critics | B | A + C |
| critics' loss and gradient | B | C + (2 C - C1) |
| actor's loss and gradient | B | A + (2 A - A1), critics C forward + C back to the actions |
| EDAC: slopes C (forward shared with the loss), directional derivative C, its gradient 2 C - C1 | B | 4 C - C1 |
| OOD term, each action (PBRL: at s and s') | B | A + C + (2 C - C1) |
| RORL's value smoothing, n draws: judged, winner differentiated (Q at s is shared) | B | n C + 2 C - C1 |
| RORL's policy smoothing, n draws: judged, winner differentiated (policy at s is shared) | B | n A + 2 A - A1 |
| outcome U(s^): actor, model, slow actor, critics forward | S | o = 2 A + D + C |
| ... back to s^ | S | o |
| ... back to the actor's parameters | S | C + A + D + (2 A - A1); without a gradient at a': no A |
| outcome term, gradient solver of j steps | S | j (o + o), then o and back once |
| outcome term, best of n draws | S | n o, then back once (the winner's pass is one of the n) |
| outcome term, mean of n draws | S | n (o and back) |
"""

import itertools
from collections.abc import Sequence
from typing import Any

from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.data.spec import Spec


def passes(sizes: Sequence[int]) -> tuple[float, float]:
    """F and F1 of a network of these widths, for one row."""
    products = [2.0 * narrow * wide for narrow, wide in itertools.pairwise(sizes)]
    return sum(products), products[0]


def to_parameters(network: tuple[float, float]) -> float:
    """A backward pass to the parameters of a network with these F and F1."""
    return 2.0 * network[0] - network[1]


def flop_per_update(algorithm: Any, spec: Spec) -> float | None:
    """Operations of one update; None for a learner or a term that the table above does not hold."""
    if not isinstance(algorithm, EnsembleSAC):
        return None
    inputs = spec.obs_dim + spec.act_dim
    members = algorithm.num_critics
    one = passes((inputs, *algorithm.hidden_sizes, 1))
    critics = (members * one[0], members * one[1])
    actor = passes((spec.obs_dim, *algorithm.hidden_sizes, 2 * spec.act_dim))
    rows = algorithm.batch_size

    total = rows * (actor[0] + critics[0])  # target
    total += rows * (critics[0] + to_parameters(critics))  # critics' loss
    total += rows * (actor[0] + to_parameters(actor) + 2.0 * critics[0])  # actor's loss
    for term in algorithm.active_terms:
        work = _term(term, rows, spec, critics, actor)
        if work is None:
            return None
        total += work
    return total


def _term(term: Any, rows: int, spec: Spec, critics: tuple[float, float], actor: tuple[float, float]) -> float | None:
    match term.name:
        case "diversity":
            return rows * (2.0 * critics[0] + to_parameters(critics))
        case "ood":
            draws = term.num_actions * (1 if term.next_deviations is None else 2)
            return rows * draws * (actor[0] + critics[0] + to_parameters(critics))
        case "value_smoothing":
            return rows * (term.num_draws * critics[0] + to_parameters(critics))
        case "policy_smoothing":
            return rows * (term.num_draws * actor[0] + to_parameters(actor))
        case "outcome":
            work = _outcome(term, spec, critics[0], actor)
            return None if work is None else (term.num_states or rows) * work
    return None


def _outcome(term: Any, spec: Spec, critics: float, actor: tuple[float, float]) -> float | None:
    model = _dynamics(term.dynamics, spec)
    if model is None:
        return None
    forward = 2.0 * actor[0] + model + critics
    backward = critics + model + to_parameters(actor) + (0.0 if term.detach_next_action else actor[0])
    if term.solver == "gradient":
        return term.ascent_steps * 2.0 * forward + forward + backward
    if term.reduce == "mean":
        return term.num_draws * (forward + backward)
    return term.num_draws * forward + backward


def _dynamics(config: Any, spec: Spec) -> float | None:
    """A forward pass of the dynamics model for one row."""
    inputs = spec.obs_dim + spec.act_dim
    if config.kind == "deterministic":
        return passes((inputs, *config.hidden_sizes, spec.obs_dim))[0]
    if config.kind == "cvae" and config.encoder == "state-action":
        hidden = config.hidden_sizes
        encoder = passes((inputs, *hidden, hidden[-1], 2 * config.latent_dim))[0]
        return encoder + passes((inputs + config.latent_dim, *hidden, spec.obs_dim))[0]
    return None
