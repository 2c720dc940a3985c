"""A plug-in's process, as `simval.plugins.child` starts it."""

import sys

from simval.plugins.child import main

if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))
