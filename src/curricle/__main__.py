"""``python -m curricle`` is the ``curricle`` command."""

from curricle.cli import main

main()
