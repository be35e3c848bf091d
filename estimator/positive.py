"""Check of numbers in a settings class."""


def must_be_positive(settings: object, *names: str) -> None:
    """Raise ValueError for the first of these settings that is not."""
    for name in names:
        if not (value := getattr(settings, name)) > 0:
            raise ValueError(f"{name} must be positive, got {value}.")
