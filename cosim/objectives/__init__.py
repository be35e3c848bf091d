"""Objectives, which score a candidate against samples: by derivatives, roll-outs or a function of the user's."""
