"""`python -m spheremcap` is `spheremcap`."""

from spheremcap.cli import main

main()
