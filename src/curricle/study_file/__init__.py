"""Study files: their tables, their arms merged and varied, and the user's own code.

``schema`` and ``task_tables`` are the tables; ``file`` reads TOML and completes the curriculum of
each arm; ``vary`` makes the arms of sweeps and tunings; ``own_code`` loads the user's modules.
"""
