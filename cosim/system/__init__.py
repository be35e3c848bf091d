"""The wired system: the order in which FMUs step, and the connections between them."""
