"""Published final scores of the public locomotion sets, to stand beside tables; never mixed with scores of our own.

All from one source, so that one protocol made them: CORL's table of last scores (Tarasov et al. 2023, "CORL:
Research-oriented Deep Offline Reinforcement Learning Library", NeurIPS Datasets and Benchmarks), means over four seeds
after a million updates, three million for SAC-N and EDAC; normalised, v2 of the public sets.
"""

SOURCE = "CORL, last checkpoint after a million updates, of SAC-N and EDAC after three"

_SETS = (
    "halfcheetah-medium",
    "halfcheetah-medium-replay",
    "halfcheetah-medium-expert",
    "hopper-medium",
    "hopper-medium-replay",
    "hopper-medium-expert",
    "walker2d-medium",
    "walker2d-medium-replay",
    "walker2d-medium-expert",
)
_SCORES: dict[str, tuple[float, ...]] = {
    "behaviour-cloning": (42.40, 35.66, 55.95, 53.51, 29.81, 52.30, 63.23, 21.80, 98.96),
    "behaviour-cloning-10-percent": (42.46, 23.59, 90.10, 55.48, 70.42, 111.16, 67.34, 54.35, 108.70),
    "td3-bc": (48.10, 44.84, 90.78, 60.37, 64.42, 101.17, 82.71, 85.62, 110.03),
    "cql": (47.04, 45.04, 95.63, 59.08, 95.11, 99.26, 80.75, 73.09, 109.56),
    "iql": (48.31, 44.46, 94.74, 67.53, 97.43, 107.42, 80.91, 82.15, 111.72),
    "rebrac": (64.04, 51.18, 103.80, 102.29, 94.98, 109.45, 85.82, 84.25, 111.86),
    "sac-n": (68.20, 60.70, 98.96, 40.82, 100.33, 101.31, 87.47, 78.99, 114.93),
    "edac": (67.70, 62.06, 104.76, 101.70, 99.66, 105.19, 93.36, 87.10, 114.75),
}


def published_score(method: str, set_name: str) -> float | None:
    """The normalised score that `SOURCE` gives for a method on the public set of that name; None where it has none.

    Args:
        method: name of our preset.
        set_name: as in `hopper-medium`.
    """
    if method not in _SCORES or set_name not in _SETS:
        return None
    return _SCORES[method][_SETS.index(set_name)]
