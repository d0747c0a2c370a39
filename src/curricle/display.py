"""Results as HTML for a notebook: tables and curves."""
