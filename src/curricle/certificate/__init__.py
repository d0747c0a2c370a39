"""Certificates: whether a shaping leaves the optimum alone, proven, refuted or sampled."""
