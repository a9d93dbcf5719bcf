"""What experience is, where it comes from, and how a learner sees it.

Everything named here loads without an array library for accelerators, except `Transitions`, `device_columns`,
`training_columns` and `sample`, which load it when first used.
"""

from typing import TYPE_CHECKING

from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec

if TYPE_CHECKING:
    from odaf.data.sampling import device_columns, sample, training_columns
    from odaf.data.transitions import Transitions

__all__ = ["Dataset", "Normaliser", "Spec", "Transitions", "device_columns", "sample", "training_columns"]


def __getattr__(name: str):
    if name == "Transitions":
        from odaf.data.transitions import Transitions

        return Transitions
    if name in ("device_columns", "sample", "training_columns"):
        from odaf.data import sampling

        return getattr(sampling, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
