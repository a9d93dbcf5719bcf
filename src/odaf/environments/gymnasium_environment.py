"""A gymnasium environment, made as a description asks, without notices about what is old by intent."""

import warnings
from collections.abc import Mapping
from typing import Any

from odaf.data.readers.minari_environment import REBUILT
from odaf.environments import contact_margins
from odaf.errors import ConfigError

# Bodies of gymnasium-robotics 1.4.2 that MuJoCo 3.12 and newer cannot simulate.
_UNTIL_311 = tuple(f"gymnasium_robotics.envs.{name}" for name in ("fetch", "shadow_dexterous_hand", "franka_kitchen"))


def make_quietly(identity: str, **kwargs: Any) -> Any:
    """`gymnasium.make`, silent where version 4 of a body is asked for, near which most scores were published.

    HalfCheetah's model holds an old word, too: the simulator would tell the terminal, and a file in this folder.
    """
    import gymnasium

    entry = str(gymnasium.spec(identity).entry_point)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "(?s).*is out of date", DeprecationWarning)
        if "mujoco" not in entry and not entry.startswith("gymnasium_robotics"):
            return gymnasium.make(identity, **kwargs)
        import mujoco

        simulator: Any = mujoco
        simulator.set_mju_user_warning(lambda _: None)
        try:
            return gymnasium.make(identity, **kwargs)
        except (AssertionError, ImportError) as error:
            raise ConfigError(_why_not(identity, entry, str(mujoco.__version__), error)) from error
        finally:
            simulator.set_mju_user_warning(None)


def make_described(description: Mapping[str, Any]) -> Any:
    """The environment that a description names: its time limit, wrappers and rule for contact margins included.

    Args:
        description: as `odaf.environments.make` takes it, with the name `gymnasium`.
    """
    identity, kwargs = description["id"], dict(description.get("kwargs") or {})
    if "max_episode_steps" in description:
        limit = description["max_episode_steps"]
        kwargs["max_episode_steps"] = -1 if limit is None else limit
    environment = make_quietly(identity, **kwargs)
    contact_margins.apply(environment, description.get("contact_margins"), identity)
    for wrapper in description.get("wrappers", ()):
        environment = _wrapped(environment, identity, wrapper)
    return environment


def check_wrappers(identity: str, wrappers: Any) -> None:
    """Raises `ConfigError` unless each wrapper is one of gymnasium's own that may be rebuilt by name."""
    for wrapper in wrappers if isinstance(wrappers, (list, tuple)) else (wrappers,):
        name = wrapper.get("name") if isinstance(wrapper, Mapping) else None
        if name not in REBUILT:
            raise ConfigError(
                f"environment '{identity}': wrapper {wrapper!r} is unknown; known are {', '.join(REBUILT)}, each as "
                '{"name": ..., "kwargs": {...}}'
            )


def _wrapped(environment: Any, identity: str, wrapper: Mapping[str, Any]) -> Any:
    import gymnasium.wrappers
    import numpy as np

    settings = {
        name: np.array(value, np.float32) if isinstance(value, list) and name.startswith(("min_", "max_")) else value
        for name, value in (wrapper.get("kwargs") or {}).items()
    }
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "(?s).*precision lowered")
            return getattr(gymnasium.wrappers, wrapper["name"])(environment, **settings)
    except (AttributeError, TypeError, ValueError, AssertionError) as error:
        raise ConfigError(
            f"environment '{identity}': its wrapper {wrapper['name']} cannot be put around it ({error}); evaluate in "
            "an environment that you name yourself"
        ) from error


def _why_not(identity: str, entry: str, version: str, error: Exception) -> str:
    if entry.startswith(_UNTIL_311) and tuple(map(int, version.split(".")[:2])) >= (3, 12):
        return (
            f"environment '{identity}': gymnasium-robotics up to 1.4.2 cannot make it with MuJoCo 3.12 and newer, and "
            f'{version} is installed; versions that work are MuJoCo 2.3 to 3.11: pip install "mujoco<3.12"'
        )
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"environment '{identity}' cannot be made with MuJoCo {version} ({text}); try another version of either"
