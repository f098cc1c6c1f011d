"""python -m spheremcap"""

from spheremcap.cli import main

main()
