"""The referee of curriculum designers: each plays each domain, with every step on the bill.

    python -m benchmarks.referee play --out referee-results     # resumes; --quick for a trial
    python -m benchmarks.referee table --out referee-results
    python -m benchmarks.referee pictures --out referee-results --clone PATH_OF_A_CLONE
    python -m benchmarks.referee lengths                        # how long scratch takes
    python -m benchmarks.referee claim PATH_OF_A_CLONE          # of f-leno/Curriculum_HFO

The command line is in ``__main__``, what is played on in ``domains``, who plays in ``players``, the
order of play in ``playing``, files in ``lines``, verdicts in ``verdicts`` and ``tables``. The
published designers are in ``designers``; recipes in relative terms and races of them, which the
library had in version 0.2.0, in ``recipes`` and ``racing``.
"""
