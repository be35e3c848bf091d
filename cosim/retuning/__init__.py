"""Re-tuning: from a sample to a write, under supervision."""
