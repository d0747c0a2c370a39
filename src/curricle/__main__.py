"""``python -m curricle`` is the ``curricle`` command."""

from curricle.cli.app import main

main()
