"""Transfer: mappings between tasks, aggregation of several sources, and the edges that use them."""
