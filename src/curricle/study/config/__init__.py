"""Studies as TOML files.

``reading`` turns a file into a ``StudyConfig``: arms are merged over the study (``merging``), names
of tasks checked (``task_names``), and the rest validated by ``study_tables``, whose parts are in
``tasks``, ``families``, ``transfers`` and ``settings``. Most of these tables are derived from the
library's own classes (``derived_tables``). ``building`` makes the curricula.
"""
