"""Task families: tasks made by one function from declared parameters, one module a family."""
