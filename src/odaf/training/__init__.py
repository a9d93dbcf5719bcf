"""Running a learner: compiled stretches, seeds, checkpoints, the run directory, logs, progress and monitors."""

from odaf.training.evaluator import Evaluation, Evaluator
from odaf.training.fit import fit, load_run, resume
from odaf.training.policy import Policy
from odaf.training.run_directory import RunDirectory

__all__ = ["Evaluation", "Evaluator", "Policy", "RunDirectory", "fit", "load_run", "resume"]
