"""`python -m simval` is the command `simval`."""

from simval.cli import main

if __name__ == "__main__":
    main()
