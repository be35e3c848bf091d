"""Studies: many runs over scenarios, factors, estimators and seeds, kept in a ledger that outlives its processes."""
