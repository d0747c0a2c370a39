"""Published gains, played again: study files, and the table of docs/what_survives.md."""
