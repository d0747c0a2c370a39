"""Learning one task: potentials, exact planning, the learners and their compiled loops."""
