"""Settings that every test shares."""

import os

from hypothesis import settings

# A first example may compile a kernel, hence no deadline. CI repeats the same examples every time.
settings.register_profile("local", deadline=None, max_examples=50)
settings.register_profile("ci", deadline=None, max_examples=50, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")
