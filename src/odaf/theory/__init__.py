"""The paper's theory where it can be computed: finite decision problems, the outcome-driven operator, its statements.

Every file holds one notion; `odaf.theory.experiments` puts each statement of the paper, as printed and as it can be
proved, to the test. NumPy in double precision throughout. docs/results/theory.md lays statements beside figures.
"""
