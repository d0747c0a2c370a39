"""Running a study: units of work, a folder that survives, any executor, several machines."""
