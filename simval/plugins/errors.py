"""The exception of plug-ins."""

from simval.errors import RefusedError


class PluginError(RefusedError):
    """A plug-in that cannot be loaded, breaks what it declares, or fails."""
