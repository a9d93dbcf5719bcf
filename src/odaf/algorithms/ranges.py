"""Ranges of settings that many learners have, said once: each check refuses the first field that lies outside."""

import math
from collections.abc import Iterable
from typing import Any

from odaf.errors import ConfigError


def require_discount(settings: Any) -> None:
    """`discount` lies in [0, 1)."""
    if not 0.0 <= settings.discount < 1.0:
        raise ConfigError(f"discount={settings.discount} must lie in [0, 1)")


def require_shares(settings: Any, fields: Iterable[str]) -> None:
    """Shares of the networks that enter slow copies at each step lie in (0, 1]."""
    for field in fields:
        if not 0.0 < getattr(settings, field) <= 1.0:
            raise ConfigError(f"{field}={getattr(settings, field)} must lie in (0, 1]: the share that moves each step")


def require_temporal_difference(settings: Any) -> None:
    """What every learner of values has: `discount`, `target_rate`."""
    require_discount(settings)
    require_shares(settings, ["target_rate"])


def require_positive(settings: Any, fields: Iterable[str]) -> None:
    """These are above 0."""
    for field in fields:
        if not getattr(settings, field) > 0.0:
            raise ConfigError(f"{field}={getattr(settings, field)} must be positive")


def require_not_negative(settings: Any, fields: Iterable[str]) -> None:
    """These are 0 or above."""
    for field in fields:
        if not getattr(settings, field) >= 0.0:
            raise ConfigError(f"{field}={getattr(settings, field)} must not be negative")


def require_counts(settings: Any, fields: Iterable[str]) -> None:
    """These are 1 or above."""
    for field in fields:
        if getattr(settings, field) < 1:
            raise ConfigError(f"{field}={getattr(settings, field)} must be at least 1")


def require_unit_interval(settings: Any, field: str, meaning: str = "") -> None:
    """This one lies in [0, 1]."""
    if not 0.0 <= getattr(settings, field) <= 1.0:
        raise ConfigError(f"{field}={getattr(settings, field)} must lie in [0, 1]{meaning and f': {meaning}'}")


def require_order(settings: Any, low: str, high: str) -> None:
    """Where both bounds are given, the lower one lies below."""
    least, most = getattr(settings, low), getattr(settings, high)
    if least is not None and most is not None and least >= most:
        raise ConfigError(f"{low}={least} must be below {high}={most}")


def require_reward_scale(settings: Any, words: str) -> None:
    """`reward_scale` is a positive number, or one of the words."""
    scale = settings.reward_scale
    if not isinstance(scale, str) and not 0.0 < scale < math.inf:
        raise ConfigError(f"reward_scale={scale} must be positive, {words}")
