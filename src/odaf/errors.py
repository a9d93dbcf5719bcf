"""The exceptions a user of odaf can meet; every message says what was expected, what came, where, and what to do."""


class OdafError(Exception):
    """Any mistake odaf can explain. The command line prints its message without a traceback and exits with 2."""


class DatasetError(OdafError):
    """Logged data that cannot be used as it is: the message names file, field, first rows and remedy."""


class ConfigError(OdafError):
    """A setting that does not exist, does not fit its neighbours, or needs something that is not installed."""


class CheckpointError(OdafError):
    """A checkpoint or run directory that is missing, damaged, or belongs to something else."""


class DivergenceError(OdafError):
    """Training left the range that the rewards allow, and the run was told to stop when that happens."""
