"""Which seeds environments are reset with, so that no policy is tried on a start that its data hold.

Evaluation episode i of evaluation seed s is reset with `EVALUATION_SEED_OFFSET + s * MOST_EPISODES + i`; data are
generated with reset seeds below the offset.
"""

EVALUATION_SEED_OFFSET = 1_000_000
MOST_EPISODES = 100_000
