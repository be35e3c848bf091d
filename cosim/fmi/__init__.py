"""FMUs as files and as instances: descriptions, variables, and the calls of FMI 2.0 and 3.0."""
