"""What `retune NAME` does: the function `command` of the module NAME."""
