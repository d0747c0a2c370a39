"""Deep learners: potentials inside networks and around them, training, checkpoints."""
