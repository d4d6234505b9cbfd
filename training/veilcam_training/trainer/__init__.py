"""The training loop: steps, evaluation, checkpoints, several processes."""
