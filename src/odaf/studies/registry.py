"""The studies by name; one more is one more entry."""

from odaf.studies.ablation import STUDY as ABLATION
from odaf.studies.antmaze import STUDY as ANTMAZE
from odaf.studies.attacks import STUDY as ATTACKS
from odaf.studies.default import STUDY as DEFAULT
from odaf.studies.estimates import STUDY as ESTIMATES
from odaf.studies.generators import STUDY as GENERATORS
from odaf.studies.guard import STUDY as GUARD
from odaf.studies.job import Study
from odaf.studies.knocks import STUDY as KNOCKS
from odaf.studies.locomotion import STUDY as LOCOMOTION
from odaf.studies.mixtures import STUDY as MIXTURES
from odaf.studies.mujoco import STUDY as MUJOCO
from odaf.studies.outcome import STUDY as OUTCOME
from odaf.studies.plant import STUDY as PLANT
from odaf.studies.pointmaze import STUDY as POINTMAZE
from odaf.studies.pointmaze_search import STUDY as POINTMAZE_SEARCH
from odaf.studies.rivals import STUDY as RIVALS
from odaf.studies.scoreboard import STUDY as SCOREBOARD
from odaf.studies.selection import STUDY as SELECTION
from odaf.studies.sweeps import STUDY as SWEEPS
from odaf.studies.theory import STUDY as THEORY
from odaf.studies.validation import STUDY as VALIDATION

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        *(POINTMAZE, OUTCOME, LOCOMOTION, RIVALS, SCOREBOARD, DEFAULT, GENERATORS, ESTIMATES, SELECTION, THEORY),
        *(GUARD, PLANT, VALIDATION, ANTMAZE, ATTACKS, KNOCKS, ABLATION, MIXTURES, MUJOCO, SWEEPS, POINTMAZE_SEARCH),
    )
}
