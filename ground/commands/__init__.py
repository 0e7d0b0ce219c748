"""One module a command of `pc-ground`, each with `add_arguments(parser)` and `run(args) -> exit status`.

Exit status: 0 done, 3 refused with the reason, 2 wrong usage (a file, an endpoint, an argument).
"""

ANSWERED, WRONG_USAGE, REFUSED = 0, 2, 3
