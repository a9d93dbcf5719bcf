"""Carrying a policy elsewhere: forms of it that need neither odaf nor JAX, and what they promise."""

from odaf.deployment.actors import DESCRIPTIONS
from odaf.deployment.artefact import FORMS, Artefact, Form, export
from odaf.deployment.policies import describe, policy_program
from odaf.deployment.program import Builder, Program

__all__ = ["DESCRIPTIONS", "FORMS", "Artefact", "Builder", "Form", "Program", "describe", "export", "policy_program"]
