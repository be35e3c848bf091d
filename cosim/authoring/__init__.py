"""Tools for users with FMUs of their own: contents of an FMU, a draft scenario, and checks."""
