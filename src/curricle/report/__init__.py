"""A study's report: one HTML page with its findings, curves, measures, forecast and replays."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
