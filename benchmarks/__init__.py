"""Timed scripts. Each prints comparable figures; the last ones, with the machine they ran on, stand in `last/`."""
