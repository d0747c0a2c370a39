"""Tasks: spaces with named components, finite MDPs, and the domains built on them."""
