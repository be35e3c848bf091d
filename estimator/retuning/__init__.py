"""The re-tuning loop: idle until triggered, then a search whose result is proposed where a diagnosis warrants it."""
