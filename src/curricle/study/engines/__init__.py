"""Where units of work are trained: an executor, a Dask cluster or a Ray cluster.

``engine`` says what a scheduler of units asks of them, opens the one that a word names, and holds
what a worker on another machine does. ``dask_engine`` and ``ray_engine`` are imported when they are
asked for.
"""
