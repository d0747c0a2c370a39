"""Where units of work are trained: an executor, a Dask cluster or a Ray cluster."""
