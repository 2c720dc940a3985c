"""Second implementations of what simval does, after the sources' own formulas."""
