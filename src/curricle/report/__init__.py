"""Reports: pictures of curves, mazes and coverage, and the page that shows them."""
