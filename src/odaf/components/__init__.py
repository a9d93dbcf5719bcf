"""Parts that learners are built from: networks, distributions, critics, targets, perturbations, dynamics models."""
