"""Studies as TOML files.

A file goes through ``reading`` (TOML, and what is wrong with it), ``merging`` (arms over the study,
a task's settings over those for all) and ``document`` (what remains, as data) to ``study_file``,
which has ``building`` make the curricula. The tables are in ``tasks``, ``transfers`` and
``settings``, all made of what is in ``tables``; ``references`` finds a user's own functions,
``graph`` checks names and ``places`` knows lines. Only ``building`` imports Curricle's loops.
"""
