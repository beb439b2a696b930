"""`python -m gelgate`: the program, where its script is not on the path."""

from gelgate import main

main()
