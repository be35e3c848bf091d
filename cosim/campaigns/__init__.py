"""Campaigns: many runs in processes of their own, compared; and replays of recorded ones."""
