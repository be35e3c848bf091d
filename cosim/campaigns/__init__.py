"""Campaigns: comparisons of many runs in processes of their own, and replays of recorded ones."""
