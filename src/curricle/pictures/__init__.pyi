from .episode import Episode as Episode
