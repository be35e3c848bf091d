"""Re-tuning: the supervised way from a sample to a write."""
