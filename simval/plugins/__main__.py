"""Main program of a plug-in's process, started by `simval.plugins.child`."""

import sys

from simval.plugins.child import main

if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3])
