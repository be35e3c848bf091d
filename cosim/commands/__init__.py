"""What `retune NAME` does: the function `command` of the module NAME. Only `options` is loaded before it is chosen."""
