"""For one who brings FMUs: what is in them, a first scenario, and what is wrong with it."""
