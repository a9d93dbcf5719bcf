"""May I run this? Everything a log can say of a policy, on one page, ending in a verdict."""

from odaf.assessment.after import Aftermath
from odaf.assessment.assess import Assessment, aftermath, assess
from odaf.assessment.conditions import Condition, Kept

__all__ = ["Aftermath", "Assessment", "Condition", "Kept", "aftermath", "assess"]
