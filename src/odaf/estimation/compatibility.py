"""Whether a policy and a log belong together, and whether actions can be weighed by their probability."""

import numpy as np

from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.errors import ConfigError, DatasetError
from odaf.estimation.settings import Acting
from odaf.training.policy import Policy

SAME_BOUNDS = 1e-5  # of the range


def require_fit(policy: Policy, dataset: Dataset) -> None:
    """Raises `ConfigError` or `DatasetError` unless the policy can act at the log's rows."""
    if policy.has_memory:
        raise ConfigError(
            f"{type(policy.actor).__name__}: remembers earlier steps, and estimates ask for actions at single states; "
            "play such a policy with `odaf evaluate`"
        )
    require_same_columns(policy, dataset)
    if dataset.num_episodes < 2:
        raise DatasetError("the log has a single episode, and intervals are over episodes; log more of them")


def require_same_columns(policy: Policy, dataset: Dataset) -> None:
    """Raises `DatasetError` unless names, widths and action bounds of the log are the policy's."""
    for what, mine, theirs in (
        ("observations", policy.observation_names, dataset.observation_names),
        ("actions", policy.action_names, dataset.action_names),
    ):
        if mine and mine != theirs:
            raise DatasetError(
                f"{what}: the policy has {', '.join(mine)}, the log {', '.join(theirs)}; read the log as the one that "
                "the policy learned from, in the same order"
            )
    if (policy.obs_dim, policy.act_dim) != (dataset.obs_dim, dataset.act_dim):
        raise DatasetError(
            f"the policy takes {policy.obs_dim} observations and gives {policy.act_dim} actions, the log has "
            f"{dataset.obs_dim} and {dataset.act_dim}; give a log of the same plant"
        )
    low, high = np.asarray(policy.action_low), np.asarray(policy.action_high)
    off = np.abs(np.stack([low - dataset.action_low, high - dataset.action_high])) > SAME_BOUNDS * (high - low)
    if off.any():
        raise DatasetError(
            f"actions: the policy's bounds are {low.tolist()} to {high.tolist()}, the log's "
            f"{dataset.action_low.tolist()} to {dataset.action_high.tolist()}; set the hold-out aside from one log "
            "with `odaf data split`, or read it with action_bounds="
        )


def why_unweighed(actor: Actor, acting: Acting) -> str:
    """Why the actor's actions cannot be weighed by their probability; empty where they can."""
    if type(actor).log_density is Actor.log_density:
        return (
            f"{type(actor).__name__}: is deterministic, so no logged action has a probability under it and none can "
            'be weighed; method="fqe" asks for no density'
        )
    if acting == "mode":
        return (
            f"{type(actor).__name__}: as deployed it takes one action at each state, so no logged action has a "
            'probability under it; acting="draws" judges the policy that draws its actions, and method="fqe" asks for '
            "no density"
        )
    return ""
