"""What a user does with a learner: presets, training with evaluation, workers, and measuring the policies again."""
