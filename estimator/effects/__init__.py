"""Effects on the plant that its model lacks: late inputs, and friction."""
