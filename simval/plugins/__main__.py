"""Main program of a plug-in's process, which `simval.plugins.child` starts."""

import sys

from simval.plugins.child import main

if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3])
