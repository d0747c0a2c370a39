"""The match of docs/referee.md: `python -m benchmarks.referee` plays it."""
