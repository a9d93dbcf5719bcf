"""Control policies from logged data of poor or mixed quality.

The names below are the promise of this package; everything else may move. They are loaded when first used, so
`import odaf` is quick and imports no array library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

_HOME_OF = {
    "BehaviourCloning": "odaf.algorithms.behaviour_cloning",
    "BehaviourDistance": "odaf.algorithms.terms",
    "CheckpointError": "odaf.errors",
    "ConfigError": "odaf.errors",
    "Conservative": "odaf.algorithms.terms",
    "Dataset": "odaf.data",
    "DatasetError": "odaf.errors",
    "DivergenceError": "odaf.errors",
    "EnsembleSAC": "odaf.algorithms.ensemble_sac",
    "GradientDiversity": "odaf.algorithms.terms",
    "InverseDynamicsAlignment": "odaf.algorithms.terms",
    "InverseDynamicsValues": "odaf.algorithms.terms",
    "ODAF": "odaf.runs.methods",
    "OODPessimism": "odaf.algorithms.terms",
    "OdafError": "odaf.errors",
    "OutcomePenalty": "odaf.algorithms.terms",
    "Plan": "odaf.runs.many",
    "Policy": "odaf.evaluation",
    "PolicySmoothing": "odaf.algorithms.terms",
    "Rollouts": "odaf.evaluation",
    "RunSettings": "odaf.training.settings",
    "Run": "odaf.evaluation",
    "StateDeviation": "odaf.algorithms.terms",
    "ValueSmoothing": "odaf.algorithms.terms",
    "advise": "odaf.data.advise",
    "aftermath": "odaf.assessment",
    "assess": "odaf.assessment",
    "combinations": "odaf.runs.many",
    "compare": "odaf.report.comparison",
    "estimate": "odaf.estimation",
    "evaluate": "odaf.runs.evaluate",
    "export": "odaf.deployment",
    "fit": "odaf.runs.fit",
    "guard": "odaf.deployment",
    "fit_many": "odaf.runs.many",
    "load_run": "odaf.runs.fit",
    "preset": "odaf.runs.methods",
    "register": "odaf.algorithms.registry",
    "resume": "odaf.runs.fit",
    "rollout": "odaf.evaluation",
    "select": "odaf.estimation",
}

# The rooms themselves, so that `odaf.environments.make` works after `import odaf`.
_ROOMS = (
    "algorithms",
    "assessment",
    "behaviour",
    "components",
    "data",
    "deployment",
    "environments",
    "estimation",
    "evaluation",
    "report",
    "runs",
    "studies",
    "training",
)

if TYPE_CHECKING:
    from odaf import algorithms as algorithms
    from odaf import behaviour as behaviour
    from odaf import components as components
    from odaf import data as data
    from odaf import deployment as deployment
    from odaf import environments as environments
    from odaf import estimation as estimation
    from odaf import evaluation as evaluation
    from odaf import report as report
    from odaf import runs as runs
    from odaf import studies as studies
    from odaf import training as training
    from odaf.algorithms.behaviour_cloning import BehaviourCloning
    from odaf.algorithms.ensemble_sac import EnsembleSAC
    from odaf.algorithms.registry import register
    from odaf.algorithms.terms import (
        BehaviourDistance,
        Conservative,
        GradientDiversity,
        InverseDynamicsAlignment,
        InverseDynamicsValues,
        OODPessimism,
        OutcomePenalty,
        PolicySmoothing,
        StateDeviation,
        ValueSmoothing,
    )
    from odaf.assessment import aftermath, assess
    from odaf.data import Dataset
    from odaf.data.advise import advise
    from odaf.deployment import export, guard
    from odaf.errors import CheckpointError, ConfigError, DatasetError, DivergenceError, OdafError
    from odaf.estimation import estimate, select
    from odaf.evaluation import Policy, Rollouts, Run, rollout
    from odaf.report.comparison import compare
    from odaf.runs.evaluate import evaluate
    from odaf.runs.fit import fit, load_run, resume
    from odaf.runs.many import Plan, combinations, fit_many
    from odaf.runs.methods import ODAF, preset
    from odaf.training.settings import RunSettings

__all__ = [
    "ODAF",
    "BehaviourCloning",
    "BehaviourDistance",
    "CheckpointError",
    "ConfigError",
    "Conservative",
    "Dataset",
    "DatasetError",
    "DivergenceError",
    "EnsembleSAC",
    "GradientDiversity",
    "InverseDynamicsAlignment",
    "InverseDynamicsValues",
    "OODPessimism",
    "OdafError",
    "OutcomePenalty",
    "Plan",
    "Policy",
    "PolicySmoothing",
    "Rollouts",
    "Run",
    "RunSettings",
    "StateDeviation",
    "ValueSmoothing",
    "__version__",
    "advise",
    "aftermath",
    "assess",
    "combinations",
    "compare",
    "estimate",
    "evaluate",
    "export",
    "fit",
    "fit_many",
    "guard",
    "load_run",
    "preset",
    "register",
    "resume",
    "rollout",
    "select",
]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(f"odaf.{name}")
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module 'odaf' has no attribute {name!r}; it offers {', '.join(sorted(_HOME_OF))}")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME_OF, *_ROOMS})
