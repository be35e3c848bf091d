"""Commands of `retune`: `retune NAME` calls the function `command` of the module NAME."""
