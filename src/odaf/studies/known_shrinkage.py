"""The four numbers of `odaf.estimation.shrinkage`, from policies of known value.

    sum log t_5( ( V - m ) / e ) / e      over policies, logs and discounts; m and e as of `shrink`, V the true value

is highest. Student's t with five degrees of freedom lets a few policies lie far away, as a policy does that is better
than anybody who wrote the log.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.studies.recorded_estimates import of_fqe

if TYPE_CHECKING:
    from odaf.estimation.shrinkage import Shrinkage

DEGREES = 5.0
STARTS = ((0.3, 0.3, 0.1, 0.5), (0.6, 0.3, 0.05, 0.5), (0.3, 0.6, 0.1, 0.2))

Known = tuple[Mapping[str, Any], int, float]
"""A valuation as records hold it, the members of its fitted Q, and the true value of its policy."""


def fitted(known: Sequence[Known]) -> "Shrinkage | None":
    """The numbers that make the true values most probable; None where nothing is known."""
    from scipy.optimize import minimize
    from scipy.stats import t

    from odaf.estimation.shrinkage import Shrinkage, error_and_size, posterior

    if not known:
        return None
    rows = []
    for valuation, members, truth in known:
        difference, own = of_fqe(valuation)
        error, size = error_and_size(difference, own, members, valuation["episodes"], valuation["confidence"])
        rows.append((difference.value / size, error / size, valuation["unlike"], (truth - own.value) / size))
    differences, errors, unlike, beside = np.array(rows).T

    def improbability(logarithms: np.ndarray) -> float:
        means, spreads, _ = posterior(differences, errors, unlike, Shrinkage(*np.exp(logarithms)))
        return -float(np.sum(t.logpdf((beside - means) / spreads, DEGREES) - np.log(spreads)))

    tries = [minimize(improbability, np.log(start), method="Nelder-Mead") for start in STARTS]
    best = min(tries, key=lambda each: each.fun)
    return Shrinkage(*(float(each) for each in np.exp(best.x)))


def in_two_digits(found: "Shrinkage") -> "Shrinkage":
    """As the package holds it."""
    from odaf.estimation.shrinkage import Shrinkage

    return Shrinkage(*(round(value, 2) for value in vars(found).values()))
