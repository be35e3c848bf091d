"""Effects on the plant that its model lacks: late or limited inputs, and friction."""
