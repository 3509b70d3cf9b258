"""`python -m fgplan` is the `fgplan` program."""

from fgplan.cli import main

main()
