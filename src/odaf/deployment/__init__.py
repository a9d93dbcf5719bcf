"""Carrying a policy elsewhere: forms of it that need neither odaf nor JAX, what they promise, and a guard beside it."""

from odaf.deployment.actors import DESCRIPTIONS
from odaf.deployment.artefact import FORMS, Artefact, Form, export
from odaf.deployment.guard import GuardedPolicy
from odaf.deployment.ingredients import GuardSettings
from odaf.deployment.make_guard import guard, guards
from odaf.deployment.policies import describe, policy_program
from odaf.deployment.program import Builder, Program

__all__ = [
    "DESCRIPTIONS",
    "FORMS",
    "Artefact",
    "Builder",
    "Form",
    "GuardSettings",
    "GuardedPolicy",
    "Program",
    "describe",
    "export",
    "guard",
    "guards",
    "policy_program",
]
