"""The front of the estimators: where a policy and a log come from, and which estimators can judge them."""

import os
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, get_args

import jax.random as jr

from odaf.components.fitting import Progress
from odaf.data.dataset import Dataset
from odaf.errors import ConfigError
from odaf.estimation.beside import Beside
from odaf.estimation.compatibility import require_fit, why_unweighed
from odaf.estimation.evidence import Evidence
from odaf.estimation.of_policy import WEIGHING
from odaf.estimation.recorded import check_horizon, shown_horizon
from odaf.estimation.settings import Acting, EstimateSettings
from odaf.estimation.valuation import Valuation
from odaf.training.policy import Policy
from odaf.training.run_directory import RunDirectory
from odaf.training.settings import products_in

Method = Literal["fqe", "shrunk", "model", "blend", "wis", "pdis", "dr", "all"]
ACTING = get_args(Acting)
ESTIMATORS: dict[str, str] = {
    "fqe": "fitted Q evaluation",
    "shrunk": "the same drawn toward the log's own value, the more the less the policy acts as the log does",
    "model": "rollouts of a fitted model",
    "blend": "the weighed mean of both, calibrated",
    "wis": "weighted importance sampling of whole episodes",
    "pdis": "weighted per-decision importance sampling",
    "dr": "weighted doubly robust",
}
"""By name, in the order of a table."""


def estimate(
    policy: Policy | str | os.PathLike[str],
    data: Dataset | str | os.PathLike[str],
    *,
    method: Method = "all",
    acting: Acting = "mode",
    discount: float = 1.0,
    horizon: int | None = None,
    log_probs: str | None = None,
    training_seed: int | None = None,
    step: int | None = None,
    seed: int = 0,
    settings: EstimateSettings | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> Valuation:
    """What a policy is worth, in the log's unit of reward, from a log that it did not learn from.

    Args:
        policy: a policy, the file of one, or a run's directory.
        data: the hold-out, such as `odaf data split` sets aside; the same columns, units and action bounds as the log
            that the policy learned from.
        method: an estimator of `ESTIMATORS`, or "all".
        acting: "mode" judges the actions that a deployed policy takes, "draws" a stochastic policy that draws them.
            Estimators that weigh actions by their probability need draws.
        discount: weight of a reward one step later; 1 sums them plainly.
        horizon: steps of an episode that are counted; None takes what the log shows, the median length of recordings
            that were cut, or the longest episode if none was.
        log_probs: column of `infos` with the log-density in nats of each logged action, in the log's units; None
            estimates it.
        training_seed: of a run, whose policy is judged; None the first.
        step: of a run, the checkpoint after so many updates; None the last.
        seed: of everything random.
        settings: sizes of what is fitted.
        progress: called with (steps done, steps in all).
        **changes: fields of `EstimateSettings` by name; they go before those in `settings`.

    Raises:
        ConfigError: an argument is out of range, or the one estimator that was asked for needs a density that the
            policy has not.
        DatasetError: policy and log do not fit, or the log has a single episode.
        CheckpointError: there is no run, policy or checkpoint.
        DivergenceError: a fit stopped being finite.
    """
    found, precision = policy_of(policy, training_seed, step)
    if method in WEIGHING and acting in ACTING and (reason := why_unweighed(found.actor, acting)):
        raise ConfigError(f"method={method}: {reason}")
    with products_in(precision):
        return estimate_many(
            [found],
            data,
            method=method,
            acting=acting,
            discounts=(discount,),
            horizon=horizon,
            log_probs=log_probs,
            seed=seed,
            settings=settings,
            progress=progress,
            **changes,
        )[0][0]


def estimate_many(
    policies: Sequence[Policy],
    data: Dataset | str | os.PathLike[str],
    *,
    method: Method = "all",
    acting: Acting = "mode",
    discounts: tuple[float, ...] = (1.0,),
    horizon: int | None = None,
    log_probs: str | None = None,
    seed: int = 0,
    settings: EstimateSettings | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> list[tuple[Valuation, ...]]:
    """What each of several policies is worth; all are fitted in one compiled program, on equal resamples of the log.

    Args:
        policies: with the same columns and action bounds as the log.
        data: the hold-out.
        method: as for `estimate`; estimators refuse the policies that they cannot judge.
        acting: as for `estimate`.
        discounts: weights of a reward one step later; fits share their networks among them.
        horizon: as for `estimate`.
        log_probs: as for `estimate`.
        seed: of everything random.
        settings: sizes of what is fitted.
        progress: called with (steps done, steps in all).
        **changes: fields of `EstimateSettings` by name; they go before those in `settings`.

    Returns:
        For each policy a valuation at each discount.

    Raises:
        ConfigError: an argument is out of range.
        DatasetError: a policy and the log do not fit, or the log has a single episode.
        DivergenceError: a fit stopped being finite.
    """
    if not policies or not discounts:
        raise ConfigError("policies=, discounts=: give at least one of each")
    chosen = tuple(ESTIMATORS) if method == "all" else (method,)
    if not set(chosen) <= set(ESTIMATORS):
        raise ConfigError(f"method={method!r} is none of {', '.join(ESTIMATORS)}, all")
    if acting not in ACTING:
        raise ConfigError(f"acting={acting!r} must be mode or draws")
    unknown = set(changes) - {field.name for field in fields(EstimateSettings)}
    if unknown:
        known = ", ".join(field.name for field in fields(EstimateSettings))
        raise ConfigError(f"{sorted(unknown)[0]}: is no setting of an estimate; there are {known}")
    settings = EstimateSettings(**{**(vars(settings) if settings is not None else {}), **changes})
    dataset = data if isinstance(data, Dataset) else Dataset.load(data)
    horizon = shown_horizon(dataset) if horizon is None else horizon
    for discount in discounts:
        check_horizon(horizon, discount)
    key_log, key = jr.split(jr.key(seed))
    plain = [policy.without_derivation() for policy in policies]
    for policy in plain:
        require_fit(policy, dataset)
    log = Evidence(dataset, horizon, discounts, settings, key_log)
    return Beside(plain, log, acting, key).valuations(chosen, log_probs, progress or (lambda done, total: None))


def policy_of(policy: Policy | str | os.PathLike[str], seed: int | None, step: int | None) -> tuple[Policy, Any]:
    """The policy, and the precision that its run computes in."""
    if isinstance(policy, Policy) or Path(policy).is_file():
        if seed is not None or step is not None:
            raise ConfigError("training_seed=, step=: choose a policy of a run; leave them out for a single policy")
        return policy if isinstance(policy, Policy) else Policy.load(policy), None
    run = RunDirectory(Path(policy))
    return run.policy(run.seeds[0] if seed is None else seed, step), run.config.get("precision")
