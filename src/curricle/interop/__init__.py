"""Other people's worlds: Gymnasium and PettingZoo, both ways, and trackers of runs."""
