"""A gymnasium environment, made without notices about what is old by intent."""

import warnings
from typing import Any


def make_quietly(identity: str, **kwargs: Any) -> Any:
    """`gymnasium.make`, silent where version 4 of a body is asked for, near which most scores were published.

    HalfCheetah's model holds an old word, too: the simulator would tell the terminal, and a file in this folder.
    """
    import gymnasium

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "(?s).*is out of date", DeprecationWarning)
        if "mujoco" not in str(gymnasium.spec(identity).entry_point):
            return gymnasium.make(identity, **kwargs)
        import mujoco

        simulator: Any = mujoco
        simulator.set_mju_user_warning(lambda _: None)
        try:
            return gymnasium.make(identity, **kwargs)
        finally:
            simulator.set_mju_user_warning(None)
