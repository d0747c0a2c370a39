"""Deep learners: sources of values, mappings of observations, potentials inside networks."""
