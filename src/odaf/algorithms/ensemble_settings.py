"""The settings of the ensemble soft actor-critic, each with the line that becomes its help text."""

import dataclasses
from typing import ClassVar, Literal

from odaf.algorithms.base import Algorithm
from odaf.algorithms.ensemble_state import EnsembleState
from odaf.algorithms.numbers import is_off
from odaf.algorithms.ranges import (
    require_counts,
    require_discount,
    require_not_negative,
    require_positive,
    require_reward_scale,
    require_shares,
)
from odaf.algorithms.terms.base import Term
from odaf.components.networks import Products
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class EnsembleSettings(Algorithm[EnsembleState]):
    """Every setting of the ensemble soft actor-critic; `EnsembleSAC` says what they do."""

    structural: ClassVar[frozenset[str]] = frozenset({"prior_scale", "critic_output_bound", "normaliser_epsilon"})

    num_critics: int = 10
    """K, the number of Q-functions."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of actor and critics."""
    critic_norm: Literal["layer", "none"] = "layer"
    """Layer normalisation inside the critics; "none" is the published form, which can diverge."""
    critic_output_bound: float = 3e-3
    """Initial weights of the critics' last layer are uniform in plus or minus this. More than the published 3e-3 makes
    the members differ where the log does not hold them together, so that their minimum is more cautious there."""
    prior_scale: float = 0.0
    """Factor of a fixed random network added to each critic and to its slow copy (PBRL-Prior 1.0); 0 adds none."""
    products: Products = "float32"
    """Format that the critics' hidden layers round the factors of their products to, on every device; sums, parameters
    and optimiser stay in float32. "bfloat16" is faster on processors with instructions for it, see
    docs/results/speed.md, "tensorfloat32" on GPUs. All other products have the run's `precision`."""
    target: Literal["min", "member"] = "min"
    """Values in the critics' targets: the lowest slow critic for all members, or each member's own slow copy."""
    target_deviations: float = 0.0
    """Standard deviations over the slow critics that are taken off those values (PBRL 0.01)."""
    value_range: Literal["auto", "none"] = "auto"
    """Clip the critics' targets to what the logged rewards allow at this discount, or do not."""
    entropy_in_backup: bool = False
    """Subtract alpha log pi from the next state's value in the target."""
    actor_critic: Literal["online", "target"] = "online"
    """Critics that the actor climbs: the online ones, or the slow ones (as printed in the ODAF paper)."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    return_steps: int = 1
    """n: targets sum the next n logged rewards before they bootstrap. More carries values back in fewer updates and
    piles up less pessimism on the way, at the price of trusting the logged actions for n steps."""
    reward_scale: Literal["auto", "unit"] | float = 1.0
    """Factor on all rewards, so that their unit does not matter. "unit" is the power of two, which rounds nothing, that
    brings the largest logged reward to a size above 0.5 and at most 1; "auto" makes the largest value that the logged
    rewards allow 10, a size that an optimiser reaches soon. Weights of terms and the entropy bonus stand beside scaled
    values; metrics are in the log's units."""
    normaliser_epsilon: float = 0.0
    """Added to the standard deviations that observations are divided by, in their own units (papers 1e-3); 0 makes
    units of no account."""
    warm_start: Literal["none", "returns"] = "none"
    """"returns" first fits the critics to the logged discounted returns and the actor to the logged actions."""
    warm_start_steps: int = 4000
    """Updates of that fit."""
    warm_start_rows: Literal["all", "drawn"] = "all"
    """Rows of that fit: all alike, or as often as `sampling` draws them for the actor, so that a start from a mostly
    poor log is one from its better part."""
    target_rate: float = 5e-3
    """Share of the online critics that enters the target critics at each update."""
    slow_actor_rate: float = 5e-3
    """Share of the actor that enters its slow copy pi' at each update."""
    deployed_actor: Literal["current", "slow"] = "current"
    """Which actor the trained policy is: pi, or pi', an average over the last updates that does not swing with each."""
    batch_size: int = 256
    """Transitions a gradient step."""
    actor_learning_rate: float = 3e-4
    """Step size of Adam for the actor."""
    critic_learning_rate: float = 3e-4
    """Step size of Adam for the critics."""
    temperature_learning_rate: float = 3e-4
    """Step size of Adam for log alpha; 0 keeps alpha at its initial value."""
    initial_temperature: float = 1.0
    """alpha at step 0."""
    target_entropy: Literal["log"] | float | None = None
    """Entropy in nats that alpha steers to; None gives minus the number of action dimensions, "log" the entropy of the
    actor that the warm start fits to the logged actions."""
    advantage_after: int = 0
    """Updates after which learned advantages take the place of what chose the actor's rows before, such as returns: the
    actor learns from the critics' rows (`critic_sampling`), and the behaviour term counts those alone whose logged
    action the critics put above the actor's own. 0 is never."""
    terms: tuple[Term, ...] = ()
    """Additions to the losses."""

    def __post_init__(self) -> None:
        require_discount(self)
        if self.num_critics < 2:
            raise ConfigError(f"num_critics={self.num_critics}: an ensemble needs at least 2")
        require_positive(self, ["initial_temperature"])
        require_shares(self, ("target_rate", "slow_actor_rate"))
        if self.target_entropy == "log" and self.warm_start == "none":
            raise ConfigError(
                "target_entropy='log' is measured by the warm start; set warm_start='returns' or a number"
            )
        require_reward_scale(self, "'auto' or 'unit'")
        require_not_negative(self, ("prior_scale", "target_deviations", "normaliser_epsilon"))
        require_counts(self, ("batch_size", "return_steps", "warm_start_steps"))
        if any(width < 1 for width in self.hidden_sizes):
            raise ConfigError(f"hidden_sizes={self.hidden_sizes} must hold widths of at least 1")
        if self.advantage_after < 0:
            raise ConfigError(f"advantage_after={self.advantage_after} must not be negative; 0 is never")
        if self.advantage_after and not any(term.name == "behaviour" for term in self.active_terms):
            raise ConfigError(
                f"advantage_after={self.advantage_after} is read by the term behaviour, which is not there; add it, or "
                "set advantage_after=0"
            )
        for term in self.active_terms:
            if term.needs_next_state and self.return_steps > 1:
                raise ConfigError(
                    f"return_steps={self.return_steps}: the term {term.name} reads the state after one step; set 1"
                )
        names = [term.name for term in self.terms]
        if len(set(names)) < len(names):
            raise ConfigError(f"terms {names} contain one term twice")

    @property
    def active_terms(self) -> tuple[Term, ...]:
        """Terms whose weight is not 0."""
        return tuple(term for term in self.terms if not is_off(term.weight))
