"""The studies by name; one more is one more entry."""

from odaf.studies.estimates import STUDY as ESTIMATES
from odaf.studies.generators import STUDY as GENERATORS
from odaf.studies.guard import STUDY as GUARD
from odaf.studies.job import Study
from odaf.studies.locomotion import STUDY as LOCOMOTION
from odaf.studies.outcome import STUDY as OUTCOME
from odaf.studies.pointmaze import STUDY as POINTMAZE
from odaf.studies.rivals import STUDY as RIVALS
from odaf.studies.scoreboard import STUDY as SCOREBOARD
from odaf.studies.selection import STUDY as SELECTION
from odaf.studies.theory import STUDY as THEORY

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (POINTMAZE, OUTCOME, LOCOMOTION, RIVALS, SCOREBOARD, GENERATORS, ESTIMATES, SELECTION, THEORY, GUARD)
}
