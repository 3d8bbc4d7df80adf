"""The version of posegsa that is installed."""

from importlib.metadata import version

VERSION = __version__ = version("posegsa")
