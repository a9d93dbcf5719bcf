"""Learners and terms by the name that configuration files use; others than ours join without editing the package.

A package of your own offers its classes by entry points, and every command knows them:

    [project.entry-points."odaf.algorithms"]
    awac = "my_package.awac:AWAC"

In Python, `odaf.register(AWAC)` does the same for one process; `odaf.fit(AWAC(), ...)` registers what it is given.
Files name a class by its `kind` or `name` alone, so reading one never decides which code is run.
"""

from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

from odaf.algorithms.atac import ATAC
from odaf.algorithms.base import Algorithm
from odaf.algorithms.bcq import BCQ
from odaf.algorithms.bear import BEAR
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.brac import BRAC
from odaf.algorithms.combo import COMBO
from odaf.algorithms.cql import CQL
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.iql import IQL
from odaf.algorithms.mbrcsl import MBRCSL
from odaf.algorithms.mopo import MOPO
from odaf.algorithms.rebrac import ReBRAC
from odaf.algorithms.scas import SCAS
from odaf.algorithms.spot import SPOT
from odaf.algorithms.svr import SVR
from odaf.algorithms.td3_bc import TD3BC
from odaf.algorithms.terms import BUILT_IN, Term
from odaf.components.dynamics import terminations
from odaf.errors import ConfigError

Kind = TypeVar("Kind", bound=type)


class Registry(Mapping[str, Kind], Generic[Kind]):
    """Classes by name: those built in, those registered, and those that installed packages offer.

    Args:
        base: what every entry is a subclass of.
        name_of: the name that files use for a class.
        group: of the entry points.
        built_in: what the package itself offers.
    """

    def __init__(self, base: type, name_of: Callable[[Any], Any], group: str, built_in: tuple[Any, ...]):
        self._base, self._name_of, self._group = base, name_of, group
        self._known: dict[str, Any] = {}
        for entry in built_in:
            self.add(entry)

    def add(self, entry: Any) -> Any:
        """Registers a class under its own name; a class that is defined anew takes the place of its former self.

        Raises:
            ConfigError: it is not a frozen dataclass of the right kind, or another class has its name.
        """
        if not (isinstance(entry, type) and issubclass(entry, self._base) and "__dataclass_fields__" in vars(entry)):
            raise ConfigError(f"{entry!r}: is not a dataclass derived from {self._base.__name__}; make it one")
        name = self._name_of(entry)
        if not isinstance(name, str) or not name:
            raise ConfigError(f"{entry.__name__}: has no name of its own; see {self._base.__module__}")
        before = self._known.get(name)
        if before is not None and (before.__module__, before.__qualname__) != (entry.__module__, entry.__qualname__):
            raise ConfigError(
                f"{entry.__module__}.{entry.__qualname__}: the name {name!r} belongs to "
                f"{before.__module__}.{before.__qualname__}; give it another"
            )
        self._known[name] = entry
        return entry

    def __getitem__(self, name: Any) -> Kind:
        if isinstance(name, str) and name not in self._known:
            for offered in entry_points(group=self._group, name=name):
                loaded = self.add(offered.load())
                if self._name_of(loaded) != name:
                    raise ConfigError(
                        f"entry point {name!r} of {self._group}: its class calls itself {self._name_of(loaded)!r}; "
                        "the two must agree"
                    )
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter([*self._known, *(name for name in self._offered() if name not in self._known)])

    def __len__(self) -> int:
        return len({*self._known, *self._offered()})

    def _offered(self) -> list[str]:
        return sorted(entry_points(group=self._group).names)


ALGORITHMS: Registry[type[Algorithm]] = Registry(
    Algorithm,
    lambda entry: getattr(entry, "kind", None),
    "odaf.algorithms",
    (EnsembleSAC, BehaviourCloning, TD3BC, IQL, ReBRAC, SPOT, SVR, SCAS, BCQ, BEAR, BRAC, CQL, ATAC)
    + (MBRCSL, MOPO, COMBO),
)
TERMS: Registry[type[Term]] = Registry(Term, lambda entry: getattr(entry, "name", None), "odaf.terms", BUILT_IN)


def register(entry: Any) -> Any:
    """Makes a learner, a term or a termination of your own known to this process; also usable as a decorator.

    Learners and terms are classes. A termination is a function that says where rollouts of a model end, see
    `odaf.components.dynamics.terminations`; the setting `termination` knows it by the function's name.

    Raises:
        ConfigError: it is none of them, or its name belongs to another one.
    """
    if callable(entry) and not isinstance(entry, type):
        return terminations.add(entry)
    return (TERMS if isinstance(entry, type) and issubclass(entry, Term) else ALGORITHMS).add(entry)


def register_parts(algorithm: Algorithm) -> tuple[Any, ...]:
    """Registers a learner's class and those of its terms; returns those that are not built in, for other processes.

    The function that says where its rollouts end is among them.

    Raises:
        ConfigError: `algorithm` is not a learner, or the name of one of the classes belongs to another one.
    """
    if not isinstance(algorithm, Algorithm):
        raise ConfigError(f"algorithm: {algorithm!r} is not a learner; give one such as odaf.ODAF()")
    parts: list[Any] = [type(algorithm), *(type(term) for term in getattr(algorithm, "terms", ()))]
    if hasattr(algorithm, "termination"):
        parts.append(terminations.termination(getattr(algorithm, "termination")))  # noqa: B009
    return tuple(register(entry) for entry in parts if not entry.__module__.startswith("odaf."))
